"""View of a vector environment for Stable-Baselines3, whose own interface for many environments differs."""

from collections.abc import Iterable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from policies.environments.vector import RobotVectorEnv

Indices = int | Iterable[int] | None


class StableBaselinesEnv(VecEnv):
    """B robots in one process for Stable-Baselines3."""

    def __init__(self, env: RobotVectorEnv) -> None:
        """Wrap a vector environment of `gymnasium.make_vec`."""
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions = np.zeros(env.action_space.shape or (), dtype=np.float32)

    def reset(self) -> VecEnvObs:
        """Begin an episode of every robot, with the seeds of `seed` if there are any."""
        seeds = [seed for seed in self._seeds if seed is not None]
        observation, _ = self.env.reset(seed=seeds or None, options=self._options[0])
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Run one policy step of every robot."""
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        infos = [_row(info, row) for row in range(self.num_envs)]
        for row in np.flatnonzero(done).tolist():
            infos[row] = _row(info["final_info"], row)
            infos[row]["terminal_observation"] = info["final_obs"][row]
        for row, cut in enumerate(truncated):
            infos[row]["TimeLimit.truncated"] = bool(cut)
        return observation, reward.astype(np.float32), done, infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_images(self) -> list[Any]:
        """Return an image of every robot."""
        return list(self.env.render() or ())

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of the environment, once for each robot."""
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the environment, which all robots share."""
        del indices
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the environment, once for each robot."""
        return [getattr(self.env, method_name)(*args, **kwargs) for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: Indices = None) -> list[bool]:
        """Return False for each robot: there are no wrappers."""
        del wrapper_class
        return [False for _ in self._get_indices(indices)]


def _row(info: dict[str, Any], row: int) -> dict[str, Any]:
    """Return the info of one robot, with plain numbers."""
    return {
        name: rows[row].copy() if rows.ndim > 1 else rows[row].item()
        for name, rows in info.items()
        if f"_{name}" in info and not name.startswith("final_")
    }
