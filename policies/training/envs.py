"""Training environment: rsl_rl's view of episodes of simulated robots."""

from collections.abc import Callable

import numpy as np
import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from policies.environments.episodes import Episodes
from policies.environments.rewards import Step
from policies.training.recipe import Recipe, contract_of
from robots.arrays import Bools
from robots.randomness import training_seed
from robots.spec import RobotSpec


class RuntimeEnv(VecEnv):
    """B robots, each with one draw for the whole training; episodes of several goals.

    Observation groups: `actor`, the contract's observation, and `privileged`, ground truth for the critic only.

    Attributes:
        episodes: the robots and their runtime. runtime: theirs.
        watchers: called after every policy step.
        due, reached: goals of the last step that ended, and those that were reached.
    """

    def __init__(self, recipe: Recipe, spec: RobotSpec, *, threads: int) -> None:
        """Build runtime and simulation, and arm every robot; results do not depend on the `threads` of physics."""
        self.num_envs, self.num_actions, self.device = recipe.environment.robots, spec.n, "cpu"
        self.cfg, self._spec = recipe.model_dump(), spec
        seeds = [training_seed(recipe.seed, robot) for robot in range(self.num_envs)]
        self.episodes = Episodes(recipe, spec, contract_of(recipe, spec, {}), seeds, threads=threads)
        self.runtime, self._task = self.episodes.runtime, self.episodes.task
        self._rng = np.random.default_rng(recipe.seed)
        self.max_episode_length = recipe.environment.goals_per_episode * self.episodes.goal_steps
        self.episode_length_buf = torch.zeros(self.num_envs, dtype=torch.long)
        self._violations = {name: np.zeros(self.num_envs) for name in ("requested", "happened")}
        self.watchers: list[Callable[[], None]] = []
        self._restart(np.ones(self.num_envs, dtype=bool))
        # Out of step from the start: goals that change for all robots at once make every batch a different world.
        elapsed = self._rng.integers(self.episodes.goal_steps, size=self.num_envs)
        self._task.elapsed[:] = elapsed * self.runtime.decimation
        self._observation = self.episodes.sense()

    def get_observations(self) -> TensorDict:
        """Return the observations of actor and critic."""
        truth, task = self.episodes.robot.truth(), self._task
        privileged = (
            truth.q,
            truth.qd / self._spec.joint_array("qd_max"),
            task.goal - task.true_achieved(truth),
            task.elapsed[:, None] * self._spec.dt / task.criterion.period_s,
            self.runtime.supervisor.stopping[:, None],
        )
        groups = {
            "actor": torch.from_numpy(self._observation),
            "privileged": torch.from_numpy(np.concatenate(privileged, axis=1)).float(),
        }
        return TensorDict(groups, batch_size=[self.num_envs])

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, object]]:
        """Run one policy step."""
        step = self.episodes.run(actions.numpy().astype(np.float64))
        total = self.episodes.reward(step)
        self.episode_length_buf += 1
        end = self.episodes.end(step, (self.episode_length_buf >= self.max_episode_length).numpy())
        # A goal that a broken limit or a diverged simulation cuts off counts as missed.
        due = self._task.ended | end.terminated
        self.due, self.reached = int(due.sum()), int(step.reached.sum())
        log = self._log(step, end.done) | self._core_success(due, step.reached)
        if end.done.any():
            self._restart(end.done)
        self._observation = self.episodes.sense()
        for watch in self.watchers:
            watch()
        rewards, dones, cut = (torch.from_numpy(x).float() for x in (total, end.done, end.truncated))
        return self.get_observations(), rewards, dones, {"time_outs": cut, "log": log}

    def _core_success(self, due: Bools, reached: Bools) -> dict[str, float]:
        """Return the share of core goals reached, of robots whose goal was `due` (B,); nothing where none was."""
        task, core = self._task, self._task.criterion.core
        if core is None:
            return {}
        counted = core.among(due, np.where(task.ended[:, None], task.ended_goal, task.goal))
        return {"Task/success_core": float(reached[counted].mean())} if counted.any() else {}

    def _restart(self, ids: Bools) -> None:
        """Rest robots at start poses, and begin their episodes."""
        self.episodes.restart(ids, self.episodes.start_poses(self._rng))
        self.episode_length_buf[torch.from_numpy(ids)] = 0
        for count in self._violations.values():
            count[ids] = 0.0

    def _log(self, step: Step, done: Bools) -> dict[str, float]:
        """Return scalars for TensorBoard; violations are policy steps with any joint, or its target, out of range."""
        self._violations["requested"] += self.episodes.limits.broken(step.q_target)
        self._violations["happened"] += self.episodes.limits.broken(step.q)
        log = {"Task/stops_per_step": float(step.stopped.mean()), "Task/running": float(step.running.mean())}
        if self.due > 0:
            log["Task/success"] = self.reached / self.due
        if done.any():
            counts = self._violations.items()
            log |= {f"joint_limit_violations/{name}": float(count[done].mean()) for name, count in counts}
        return log
