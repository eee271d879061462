"""B simulated robots in one process as a Gymnasium vector environment."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from eval.video.renderer import Image
from policies.environments.pictures import Screen, render_modes
from policies.environments.session import Info, Session, Transition
from policies.environments.single import SEEDS, check_reset_options, row_of
from robots.arrays import Bools, Floats
from robots.errors import ConfigError


class RobotVectorEnv(VectorEnv[Any, NDArray[np.float32], Any]):
    """B robots that advance together: physics and runtime are arrays over the robots.

    An episode that ended begins anew in the same step: `final_obs` and `final_info` hold its end. Seeds are those of B
    single environments: `reset(seed=s)` makes robot i from s + i. Bits are the same for equal seeds and B; rows of
    another B agree to rounding.

    Attributes:
        session: the robots and their runtime.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["human", "rgb_array"],
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }
    goal: ClassVar[bool] = False
    """Observations are dictionaries with goals."""

    def __init__(self, num_envs: int = 1, max_episode_steps: int | None = None, **options: Any) -> None:
        """Check the options, as `policies.environments.settings.Options`; episodes can be cut shorter.

        Raises:
            FirstshiftError: naming the option, what was found and what was expected.
        """
        for name, found in {"num_envs": num_envs, "max_episode_steps": max_episode_steps}.items():
            if found is not None and found < 1:
                raise ConfigError(f"option {name}: found {found}, expected at least 1")
        self.session, self.num_envs = Session(options, num_envs, goal=self.goal), num_envs
        self.session.max_steps = min(self.session.max_steps, max_episode_steps or self.session.max_steps)
        self.single_action_space = self.session.action_space
        self.single_observation_space = self.session.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.render_mode = self.session.settings.render_mode
        self.metadata = {
            **type(self).metadata,
            "render_modes": render_modes(),
            "render_fps": self.session.settings.contract.policy_hz,
        }
        self._screen = Screen(self.session)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode of every robot; a seed, or one for each, makes other robots."""
        first = seed if isinstance(seed, int) or seed is None else None
        super().reset(seed=first)
        check_reset_options(options)
        if seed is not None or not self.session.seeded:
            self.session.seed(self._seeds(seed))
        self.session.begin(np.ones(self.num_envs, dtype=bool))
        observation = self.session.observe()
        self._screen.update()
        return observation, {}

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, Floats, Bools, Bools, dict[str, Any]]:
        """Run one policy step of every robot; episodes that ended begin anew."""
        transition = self.session.step(actions)
        observation, end = transition.observation, transition.end
        info = masked(transition.info, ~end.done)
        if end.done.any():
            info |= self._final(transition)
            self.session.begin(end.done)
            observation = self.session.observe()
        self._screen.update()
        return observation, transition.reward, end.terminated, end.truncated, info

    def render(self) -> tuple[Image, ...] | None:
        """Return an image (H, W, 3) of every robot in render mode "rgb_array", else None."""
        if self.render_mode != "rgb_array":
            return None
        return tuple(self._screen.image(row) for row in range(self.num_envs))

    def close_extras(self, **_: Any) -> None:
        """Close window and renderer."""
        self._screen.close()

    def _seeds(self, seed: int | Sequence[int] | None) -> list[int]:
        if isinstance(seed, int):
            return [seed + robot for robot in range(self.num_envs)]
        if seed is None:
            return [int(number) for number in self.np_random.integers(SEEDS, size=self.num_envs)]
        if len(seed) != self.num_envs:
            raise ConfigError(f"reset: seed: found {len(seed)} seeds, expected {self.num_envs}")
        return [int(number) for number in seed]

    def _final(self, transition: Transition) -> dict[str, Any]:
        done = transition.end.done
        last = np.full(self.num_envs, None, dtype=object)
        for row in np.flatnonzero(done).tolist():
            last[row] = row_of(transition.observation, row)
        info = masked(transition.info, done)
        return {"final_obs": last, "_final_obs": done, "final_info": info, "_final_info": done.copy()}


class RobotGoalVectorEnv(RobotVectorEnv):
    """Environment with goals for hindsight: one goal in an episode, and its sparse reward."""

    goal: ClassVar[bool] = True

    def compute_reward(self, achieved_goal: Floats, desired_goal: Floats, info: Any) -> Floats:
        """Return the rewards (...,) of transitions for any goals, as `GoalReward`."""
        return self.session.reward(achieved_goal, desired_goal, info)


def masked(info: Info, ids: Bools) -> dict[str, Any]:
    """Return info of the robots where `ids` (B,) holds, zeros elsewhere, with a mask for each field."""
    rows = {
        name: np.where(ids.reshape(-1, *[1] * (v.ndim - 1)), v, 0).astype(v.dtype) for name, v in info.items()
    }
    return rows | {f"_{name}": ids.copy() for name in rows}
