"""Episodes of B simulated robots: the runtime, policy step by policy step, with the caller in the policy's place.

It has no physics, filter or smoother of its own: a policy step is `act`, then `sense` until the policy is due.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deploy.policy.contract import Contract
from deploy.simulation import simulate
from deploy.state import Mode
from deploy.tasks.success import SuccessCriterion, SuccessEvaluation
from policies.environments.rewards import Limits, Step, reward_terms, shaping
from policies.training.recipe import Recipe
from robots.arrays import Bools, Float32s, Floats
from robots.models.fleet import Fleet
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec


class End(NamedTuple):
    """Episodes (B,) that ended with a policy step.

    Attributes:
        terminated: a joint is out of range, or the simulation diverged.
        truncated: the time is over, and it did not terminate.
    """

    terminated: Bools
    truncated: Bools

    @property
    def done(self) -> Bools:
        """(B,) ended in either way."""
        return self.terminated | self.truncated


def goal_steps(criterion: SuccessCriterion, policy_hz: int) -> int:
    """Return the policy steps for each goal."""
    return round(criterion.period_s * policy_hz)


class Episodes:
    """B robots, each with one draw; the caller counts the steps of an episode.

    A policy step is `run`, then `restart` of robots whose episode ended, then `sense`.

    Attributes:
        runtime: the shipped one. robot: the simulation. task: of the runtime.
        limits: working range of the joints.
        goal_steps: policy steps for each goal.
        peak_qd: (B, n) rad/s, the largest true joint speeds, until the caller clears them.
    """

    def __init__(
        self,
        recipe: Recipe,
        spec: RobotSpec,
        contract: Contract,
        seeds: Sequence[np.random.SeedSequence],
        *,
        threads: int,
    ) -> None:
        """Build runtime and simulation; `restart` everybody first.

        Args:
            recipe: rewards. contract: of the policy in training.
            seeds: B seeds: one draw, one stream of noise and one sequence of goals each.
            threads: for physics; results do not depend on it.
        """
        self.runtime, self.robot = simulate(spec, contract, seeds, threads=threads)
        self.task, self._criterion = self.runtime.task, self.runtime.task.criterion
        self._angles = contract.action.control_mode is ControlMode.POSITION
        self._spec, self._recipe, self._fleet = spec, recipe, Fleet(spec, len(seeds))
        self.limits = Limits(spec, recipe.reward.near_share)
        self.goal_steps = goal_steps(self._criterion, contract.policy_hz)
        self._last_action, self.peak_qd = np.zeros((2, len(seeds), spec.n))
        self._success = SuccessEvaluation(self._criterion, len(seeds), spec.dt)
        self._number, self._everyone = self.task.number.copy(), np.ones(len(seeds), dtype=bool)

    def start_poses(self, rng: np.random.Generator) -> Floats:
        """Draw (B, n) rad by the recipe: in a share of the joint ranges, or by the task."""
        share = self._recipe.environment.start_range
        if share is None:
            return self.task.start_poses(rng)
        return self.limits.draw(rng, share, len(self._last_action))

    def restart(self, ids: Bools, q: Floats) -> None:
        """Rest robots where `ids` (B,) holds at `q` (B, n) rad, with a new goal; `sense` powers them."""
        self.robot.reset(ids, q)
        self.runtime.reset(ids)
        self._last_action[ids] = 0.0

    def sense(self) -> Float32s:
        """Return the observation (B, N); robots without power, as after a restart, are armed."""
        observation = self.runtime.sense()
        if observation is None:
            raise RuntimeError(f"tick {self.runtime.ticks} is between policy ticks")
        off = ~self.runtime.supervisor.powered
        if off.any():
            self.runtime.arm(off)
        return observation.copy()

    def run(self, action: Floats) -> Step:
        """Act until the policy is due again; the caller does the last `sense`, after restarts."""
        runtime, qdd, goal = self.runtime, self.runtime.setpoint.qdd.copy(), self.task.goal.copy()
        stopped, ended, reached = np.zeros((3, len(qdd)), dtype=bool)
        # Restarts and, in some tasks, arming give a new goal before its time.
        self._success.reset(self.task.number != self._number)
        for tick in range(runtime.decimation):
            if tick:
                runtime.sense()
            running = runtime.supervisor.mode == Mode.RUNNING
            runtime.act(None if tick else action)
            stopped |= running & (runtime.supervisor.mode != Mode.RUNNING)
            ended |= self.task.ended
            reached |= self._count_success()
            np.fmax(
                self.peak_qd, np.abs(self.robot.plant.qd), out=self.peak_qd
            )  # fmax: NaN of a diverged one
        self._number[:] = self.task.number
        running = runtime.supervisor.mode == Mode.RUNNING
        near = np.where(ended, reached, self._near(goal))
        decisions = {"reached": reached & running, "near": near & running}
        decisions |= {"running": running, "stopped": stopped}
        return self._measure(action, goal, qdd, decisions)

    def _count_success(self) -> Bools:
        """Return (B,) goals that ended in this tick and were truly reached, were their robots running or not."""
        achieved = self.task.true_achieved(self.robot.truth())
        reached = self._success.step(achieved, self.task.ended_goal, self.task.ended, self._everyone)
        return ~self._everyone if reached is None else reached

    def _near(self, goal: Floats) -> Bools:
        achieved = self.task.true_achieved(self.robot.truth())
        return self._success.near(achieved, goal, self.task.elapsed)

    def reward(self, step: Step) -> Floats:
        """(B,) reward and shaping of a step by the recipe."""
        total = reward_terms(step, self.limits, self._recipe.reward).total
        total += shaping(step, self.limits, self._recipe.shaping)
        return np.where(self.robot.plant.valid, total, self._recipe.reward.joint_limit)

    def end(self, step: Step, time_over: Bools) -> End:
        """Return the episodes that a step ended; `time_over` (B,): it was their last."""
        failed = self.limits.broken(step.q) | ~self.robot.plant.valid
        return End(failed, time_over & ~failed)

    def _measure(self, action: Floats, goal: Floats, qdd: Floats, decisions: dict[str, Bools]) -> Step:
        """Return the step that has just ended, with the goal and the setpoint's acceleration at its beginning."""
        runtime, truth = self.runtime, self.robot.truth()
        change = runtime.action.last - self._last_action
        self._last_action[:] = runtime.action.last
        return Step(
            q=truth.q,
            qd=truth.qd,
            tau=truth.tau,
            qdd_change=runtime.setpoint.qdd - qdd,
            dt=runtime.decimation * self._spec.dt,
            distance=self._distance(goal),
            q_target=runtime.target.value if self._angles else truth.q,
            action_change=change,
            action_excess=self._excess(action),
            manipulability=self._manipulability(truth.q),
            **decisions,
        )

    def _manipulability(self, q: Floats) -> Floats:
        """(B,) at joint angles (B, n) rad; infinite for robots without a tool."""
        if "manipulability" not in self._spec.capabilities:
            return np.full(len(q), np.inf)
        return self._fleet.kinematics(q).manipulability()

    def _excess(self, action: Floats) -> Floats:
        """Return the part of actions beyond the contract's clip; 0 for non-finite actions, which stop the robot."""
        excess = action - np.clip(action, *self.runtime.contract.action.bounds)
        return np.where(np.isfinite(action), excess, 0.0)

    def _distance(self, goal: Floats) -> Floats:
        return self._criterion.distance(self.task.true_achieved(self.robot.truth()), goal)
