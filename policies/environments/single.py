"""One simulated robot as a Gymnasium environment."""

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from policies.environments.pictures import Screen, render_modes
from policies.environments.session import Info, Observation, Session
from robots.arrays import Floats
from robots.errors import ConfigError

ONE = np.ones(1, dtype=bool)
SEEDS = 2**31
"""Number of seeds to choose from, where none is given."""


class RobotEnv(gymnasium.Env[Any, Any]):
    """The runtime on one simulated robot, with the caller in the policy's place; reward and shaping by the recipe.

    `reset(seed=...)` makes the robot anew, and everything that follows from it; `reset()` begins its next episode.

    Attributes:
        session: the robot and its runtime.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 50}  # noqa: RUF012
    goal: ClassVar[bool] = False
    """Observations are dictionaries with goals."""

    def __init__(self, **options: Any) -> None:
        """Check the options, as `policies.environments.settings.Options`.

        Raises:
            FirstshiftError: naming the option, what was found and what was expected.
        """
        self.session = Session(options, 1, goal=self.goal)
        self.action_space, self.observation_space = (
            self.session.action_space,
            self.session.observation_space,
        )
        self.render_mode = self.session.settings.render_mode
        self.metadata = {
            "render_modes": render_modes(),
            "render_fps": self.session.settings.contract.policy_hz,
        }
        self._screen, self._ended = Screen(self.session), True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; a seed makes another robot."""
        super().reset(seed=seed)
        check_reset_options(options)
        if seed is not None or not self.session.seeded:
            self.session.seed([int(self.np_random.integers(SEEDS)) if seed is None else seed])
        self.session.begin(ONE)
        self._ended = False
        observation = row_of(self.session.observe(), 0)
        self._screen.update()
        return observation, {}

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Run one policy step."""
        if self._ended:
            raise ResetNeeded("the episode has ended: reset() comes first")
        transition = self.session.step(np.asarray(action)[None])
        self._ended = bool(transition.end.done[0])
        self._screen.update()
        return (
            row_of(transition.observation, 0),
            float(transition.reward[0]),
            bool(transition.end.terminated[0]),
            bool(transition.end.truncated[0]),
            info_of(transition.info, 0),
        )

    def render(self) -> Any:
        """Return an image (H, W, 3) in render mode "rgb_array", else None."""
        return self._screen.image(0) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close window and renderer."""
        self._screen.close()


class RobotGoalEnv(RobotEnv):
    """Environment with goals for hindsight: one goal in an episode, and its sparse reward."""

    goal: ClassVar[bool] = True

    def compute_reward(self, achieved_goal: Floats, desired_goal: Floats, info: Any) -> Any:
        """Return the reward of transitions for any goals, as `GoalReward`; for a single one, a number."""
        reward = self.session.reward(achieved_goal, desired_goal, info)
        return reward if reward.ndim else float(reward)


def row_of(observation: Observation, row: int) -> Any:
    """Return the observation of one robot."""
    if isinstance(observation, dict):
        return {name: rows[row].copy() for name, rows in observation.items()}
    return observation[row].copy()


def info_of(info: Info, row: int) -> dict[str, Any]:
    """Return the info of one robot, with plain numbers."""
    return {name: rows[row].copy() if rows.ndim > 1 else rows[row].item() for name, rows in info.items()}


def check_reset_options(options: dict[str, Any] | None) -> None:
    """Refuse (ConfigError) options of a reset: there are none."""
    if options:
        raise ConfigError(f"reset: options: found {', '.join(options)}, expected none")
