"""Sparse reward of a transition for any goal, from what the transition carries in its info."""

from collections.abc import Mapping, Sequence

import numpy as np

from deploy.tasks.success import SuccessCriterion
from policies.environments.rewards import RewardTerms
from policies.training.recipe import Reward
from robots.arrays import Floats
from robots.errors import ConfigError

TERMS = RewardTerms._fields[1:]
"""Terms of the reward that do not depend on the goal."""
CARRIED = ("achieved_error", "running", *TERMS)
"""Fields of info that the reward needs: achieved_error is what was truly achieved less the robot's estimate of it."""

Info = Mapping[str, object]


class GoalReward:
    """Success of a running robot as long as its true distance from the goal is within tolerance, and the other terms.

    Distances are true ones, while `achieved_goal` is the robot's estimate.
    """

    def __init__(self, criterion: SuccessCriterion, weights: Reward) -> None:
        self._criterion, self._weights = criterion, weights

    def __call__(self, achieved: Floats, desired: Floats, info: Info | Sequence[Info]) -> Floats:
        """Return the rewards (...,) of transitions to `achieved` (..., G) for goals `desired` (..., G).

        Args:
            achieved: as observed. desired: any goals.
            info: of the transitions: one dictionary, with rows for a batch, or one dictionary for each.

        Raises:
            ConfigError: a field is missing.
        """
        carried = _fields(info)
        near = (
            self._criterion.distance(achieved + carried["achieved_error"], desired)
            <= self._criterion.tolerance
        )
        success = np.asarray(self._weights.success * (near & (carried["running"] > 0)), dtype=np.float64)
        return RewardTerms(success, *(carried[name] for name in TERMS)).total


def _fields(info: Info | Sequence[Info]) -> dict[str, Floats]:
    try:
        if isinstance(info, Mapping):
            return {name: np.asarray(info[name], dtype=np.float64) for name in CARRIED}
        return {name: np.array([each[name] for each in info], dtype=np.float64) for name in CARRIED}
    except KeyError as e:
        expected = "the info of a transition (HerReplayBuffer: copy_info_dict=True)"
        raise ConfigError(f"compute_reward: info: found no {e.args[0]!r}, expected {expected}") from e
