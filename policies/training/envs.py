"""Training environment: the runtime on simulated robots, with the learner in the policy's place.

It has no physics, filter or smoother of its own: an environment step is `act`, then `sense` until the policy is due.
"""

import numpy as np
import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from deploy.simulation import simulate
from deploy.state import Mode
from policies.training.recipe import Recipe, contract_of
from policies.training.rewards import Limits, Step, reward, shaping
from robots.arrays import Bools, Floats
from robots.models.fleet import Fleet
from robots.randomness import training_seed
from robots.spec import RobotSpec


class RuntimeEnv(VecEnv):
    """B robots, each with one draw for the whole training; episodes of several goals.

    Observation groups: `actor`, the contract's observation, and `privileged`, ground truth for the critic only.
    """

    def __init__(self, recipe: Recipe, spec: RobotSpec, *, threads: int) -> None:
        """Build runtime and simulation, and arm every robot; results do not depend on the `threads` of physics."""
        self.num_envs, self.num_actions, self.device = recipe.environment.robots, spec.n, "cpu"
        self.cfg, self._recipe, self._spec = recipe.model_dump(), recipe, spec
        seeds = [training_seed(recipe.seed, robot) for robot in range(self.num_envs)]
        self.runtime, self._robot = simulate(spec, contract_of(recipe, spec, {}), seeds, threads=threads)
        self._task, self._criterion = self.runtime.task, self.runtime.task.criterion
        self._fleet = Fleet(spec, self.num_envs)
        self._limits = Limits(spec, recipe.reward.near_share)
        self._rng = np.random.default_rng(recipe.seed)
        period = round(self._criterion.period_s * recipe.promise.policy_hz)
        self.max_episode_length = recipe.environment.goals_per_episode * period
        self.episode_length_buf = torch.zeros(self.num_envs, dtype=torch.long)
        self._violations = {name: np.zeros(self.num_envs) for name in ("requested", "happened")}
        self._last_action = np.zeros((self.num_envs, spec.n))
        self._restart(np.ones(self.num_envs, dtype=bool))
        # Out of step from the start: goals that change for all robots at once make every batch a different world.
        self._task.elapsed[:] = self._rng.integers(period, size=self.num_envs) * self.runtime.decimation
        self._observation = self._sense()

    def get_observations(self) -> TensorDict:
        """Return the observations of actor and critic."""
        truth, task = self._robot.truth(), self._task
        privileged = (
            truth.q,
            truth.qd / self._spec.joint_array("qd_max"),
            task.goal - task.true_achieved(truth),
            task.elapsed[:, None] * self._spec.dt / self._criterion.period_s,
            self.runtime.supervisor.stopping[:, None],
        )
        groups = {
            "actor": torch.from_numpy(self._observation.copy()),
            "privileged": torch.from_numpy(np.concatenate(privileged, axis=1)).float(),
        }
        return TensorDict(groups, batch_size=[self.num_envs])

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, object]]:
        """Run one policy step."""
        step = self._run_period(actions.numpy().astype(np.float64))
        total, broken = reward(step, self._limits, self._recipe.reward)
        total += shaping(step, self._limits, self._recipe.shaping)
        valid = self._robot.truth().valid
        total = np.where(valid, total, self._recipe.reward.joint_limit)
        self.episode_length_buf += 1
        time_out = (self.episode_length_buf >= self.max_episode_length).numpy()
        done = broken | time_out | ~valid
        # A goal that a broken limit or a diverged simulation cuts off counts as missed.
        self.due = int((self.runtime.task.ended | broken | ~valid).sum())
        self.reached = int(step.reached.sum())
        log = self._log(step, broken, done)
        if done.any():
            self._restart(done)
        self._observation = self._sense()
        rewards, dones, cut = (torch.from_numpy(x).float() for x in (total, done, time_out & ~broken))
        return self.get_observations(), rewards, dones, {"time_outs": cut, "log": log}

    def _run_period(self, action: np.ndarray) -> Step:
        """Act until the policy is due again; the caller does the last `sense`, after resets."""
        runtime, task, qdd = self.runtime, self._task, self.runtime.setpoint.qdd.copy()
        stopped, reached = np.zeros((2, self.num_envs), dtype=bool)
        goal = task.goal.copy()
        for tick in range(runtime.decimation):
            if tick:
                runtime.sense()
            running = runtime.supervisor.mode == Mode.RUNNING
            runtime.act(None if tick else action)
            stopped |= running & (runtime.supervisor.mode == Mode.STOPPING)
            reached |= task.ended & (self._distance(task.ended_goal) <= self._criterion.tolerance)
        running = runtime.supervisor.mode == Mode.RUNNING
        decisions = {"reached": reached & running, "running": running, "stopped": stopped}
        return self._measure(action, goal, qdd, decisions)

    def _measure(self, action: np.ndarray, goal: Floats, qdd: Floats, decisions: dict[str, Bools]) -> Step:
        """Return the step that has just ended, with the goal and the setpoint's acceleration at its beginning."""
        runtime, truth = self.runtime, self._robot.truth()
        change = runtime.action.last - self._last_action
        self._last_action[:] = runtime.action.last
        return Step(
            q=truth.q,
            qd=truth.qd,
            tau=truth.tau,
            qdd_change=runtime.setpoint.qdd - qdd,
            dt=runtime.decimation * self._spec.dt,
            distance=self._distance(goal),
            q_target=runtime.target.q,
            action_change=change,
            action_excess=self._excess(action),
            manipulability=self._manipulability(truth.q),
            **decisions,
        )

    def _manipulability(self, q: Floats) -> Floats:
        """(B,) at joint angles (B, n) rad; infinite for robots without a tool."""
        if "manipulability" not in self._spec.capabilities:
            return np.full(self.num_envs, np.inf)
        return self._fleet.kinematics(q).manipulability()

    def _excess(self, action: np.ndarray) -> np.ndarray:
        """Return the part of actions beyond the contract's clip; 0 for non-finite actions, which stop the robot."""
        excess = action - np.clip(action, *self.runtime.contract.action.bounds)
        return np.where(np.isfinite(action), excess, 0.0)

    def _distance(self, goal: np.ndarray) -> np.ndarray:
        return self._criterion.distance(self._task.true_achieved(self._robot.truth()), goal)

    def _sense(self) -> np.ndarray:
        """Return the observation; robots without power, as after a reset, are armed."""
        observation = self.runtime.sense()
        if observation is None:
            raise RuntimeError(f"tick {self.runtime.ticks} is between policy ticks")
        off = ~self.runtime.supervisor.powered
        if off.any():
            self.runtime.arm(off)
        return observation

    def _restart(self, ids: Bools) -> None:
        """Rest robots at start poses of the task, and begin their episodes."""
        self._robot.reset(ids, self._task.start_poses(self._rng))
        self.runtime.reset(ids)
        self.episode_length_buf[torch.from_numpy(ids)] = 0
        self._last_action[ids] = 0.0
        for count in self._violations.values():
            count[ids] = 0.0

    def _log(self, step: Step, broken: Bools, done: Bools) -> dict[str, float]:
        """Return scalars for TensorBoard; violations are policy steps with any joint, or its target, out of range."""
        self._violations["requested"] += (self._limits.beyond(step.q_target) > 0).any(axis=1)
        self._violations["happened"] += broken
        log = {"Task/stops_per_step": float(step.stopped.mean()), "Task/running": float(step.running.mean())}
        if self.due > 0:
            log["Task/success"] = self.reached / self.due
        if done.any():
            counts = self._violations.items()
            log |= {f"joint_limit_violations/{name}": float(count[done].mean()) for name, count in counts}
        return log
