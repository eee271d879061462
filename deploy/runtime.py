"""The tick, in order, and nothing else: on one robot or on five hundred, simulated or real, soaked or shipped."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from deploy.backends.backend import Robot
from deploy.estimation.estimator import Estimator
from deploy.estimation.floating_base.floating_base import FloatingBase
from deploy.masks import all_true, any_true
from deploy.motion.drive_law import SpringDrives
from deploy.motion.smoother import Smoother
from deploy.policy.action import Action
from deploy.policy.contract import Contract
from deploy.policy.observation import Observation, Sources
from deploy.policy.policy import Policy
from deploy.safety.safety import Safety
from deploy.safety.supervisor import Supervisor
from deploy.stage import Arrays, Stage, inside
from deploy.state import BaseState, Command, Reason, Sample, Setpoint, State, Target, Verdict
from deploy.tasks.reach import Reach
from deploy.tasks.velocity import Velocity
from robots.arrays import Bools, Float32s, Floats, Ints
from robots.gains import same_gains
from robots.models.fleet import Fleet
from robots.models.kinematics import Kinematics
from robots.spec import RobotSpec

UNSEEN_S = 1.0
"""s without a picture of it after which a goal is none any more."""


class Runtime(Stage):
    """B robots under one policy.

    `sense` and `act` are the two halves of a tick; a policy, shipped or in training, sits between them. After a tick
    every record of it can be read: `state`, `target`, `verdict`, `setpoint`, `command`; after a restore only once it
    has ticked. What is saved is what decides the next tick, without the robot's own.
    """

    carried = ("asked", "since", "_tool", "_goal")
    parts = ("estimator", "action", "smoother", "supervisor", "task", "observation")

    state: State
    verdict: Verdict
    command: Command
    _kinematics: Kinematics

    def __init__(
        self,
        spec: RobotSpec,
        contract: Contract,
        robot: Robot,
        seeds: Sequence[np.random.SeedSequence],
        policy: Policy | None = None,
    ) -> None:
        """Build every stage; nothing moves until `arm`.

        Args:
            spec: the robot.
            contract: what the policy was promised, checked against `spec` beforehand.
            robot: the backend, B robots wide.
            seeds: B seeds, from which each robot's goals follow.
            policy: None where the caller puts its own between `sense` and `act`.

        Raises:
            RuntimeError: the drives have other gains than the contract.
        """
        self.spec, self.contract, self.robot, self.policy = spec, contract, robot, policy
        robots = robot.robots
        self.ticks, self.decimation = 0, contract.control_hz // contract.policy_hz
        self._period_s = contract.period_s
        self.fleet, checked = Fleet(spec, robots), Fleet(spec, 2 * robots, collisions=True)
        gains = contract.action.gains
        if not same_gains(gains, robot.gains):
            raise RuntimeError("the robot's drives have other gains than the policy's contract")
        self.springs = SpringDrives(spec, gains) if gains and spec.base else None
        self.estimator = Estimator(spec, robots, springs=gains if self.springs else None)
        self.safety = Safety(spec, checked, self.springs)
        self.action = Action(contract.action, robots)
        self.smoother = Smoother(spec, robots)
        self.supervisor = Supervisor(robots, spec.dt)
        self.walker = FloatingBase(spec, spec.base, robots) if spec.base else None
        self.task = Velocity(spec, spec.base, seeds) if spec.base else Reach(spec, seeds)
        self.observation = Observation(contract, self._sources(), robots)
        self.asked, self.since = np.zeros((2, robots), dtype=np.int64)
        rest = np.zeros((robots, spec.n))
        self._nothing = rest, rest
        self._ahead, self._tau_ahead = Setpoint(q=rest, qd=rest, qdd=rest), rest
        self._tool, self._goal = np.zeros((2, robots, 3))
        if policy is not None:
            policy.resize(robots)

    def save(self) -> Arrays:
        """Copies of what every stage carries, of the stop that is prepared, and of the number of ticks."""
        ahead = {"q": self._ahead.q, "qd": self._ahead.qd, "qdd": self._ahead.qdd, "tau": self._tau_ahead}
        stop: Arrays = {f"ahead.{name}": array.copy() for name, array in ahead.items()}
        others = {"policy": self.policy, "walker": self.walker}
        known = {f"{part}.{n}": a for part, stage in others.items() if stage for n, a in stage.save().items()}
        return super().save() | stop | known | {"ticks": np.array(self.ticks)}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back, bit for bit."""
        super().restore(arrays)
        q, qd, qdd, tau = (
            np.array(arrays[f"ahead.{name}"], dtype=float) for name in ("q", "qd", "qdd", "tau")
        )
        self._ahead, self._tau_ahead = Setpoint(q=q, qd=qd, qdd=qdd), tau
        if self.policy is not None:
            self.policy.restore(inside(arrays, "policy"))
        if self.walker is not None:
            self.walker.restore(inside(arrays, "walker"))
        self.ticks = int(arrays["ticks"])

    def _sources(self) -> Sources:
        return {
            "joint_position": lambda: self.state.q,
            "joint_velocity": lambda: self.state.qd,
            "tool_position": lambda: self._tool,
            "goal_position": lambda: self._goal,
            "goal_from_tool": lambda: self._goal - self._tool,
            "goal_torque": lambda: self._kinematics.torque_of_tool_force(self._goal - self._tool),
            "target_offset": lambda: self.action.q - self.state.q,
            "last_action": lambda: self.action.last,
            "base_angular_velocity": lambda: self._base.angular_velocity,
            "base_linear_velocity": lambda: self._base.velocity_in_base,
            "base_orientation": lambda: self._base.quat_wxyz,
            "projected_gravity": lambda: self._base.gravity,
            "velocity_command": lambda: self.task.goal,
            "gait_phase": self._phase,
        }

    @property
    def _base(self) -> BaseState:
        if self.state.base is None:
            raise RuntimeError("a robot without a base was asked for it")
        return self.state.base

    def _phase(self) -> Floats:
        """(B, 2) sine and cosine of the time since arming."""
        phase = 2.0 * np.pi / self._period_s * self.spec.dt * self.since
        return np.stack((np.sin(phase), np.cos(phase)), axis=1)

    @property
    def t(self) -> float:
        """s, when the coming tick is due."""
        return self.ticks * self.spec.dt

    @property
    def target(self) -> Target:
        """What the policy wants, before any limit."""
        return self.action.target

    @property
    def setpoint(self) -> Setpoint:
        """What was sent last."""
        return self.smoother.sent

    @property
    def tool(self) -> Floats:
        """(B, 3) what a goal of the task is compared with.

        m, where the tool is believed to be in the world; renewed whenever the policy is due. Of a robot with a base m/s
        forwards, m/s to the left, rad/s to the left, as it is believed to move.
        """
        return self._tool

    def tick(self) -> None:
        """Sense, think when it is time to, act."""
        observation = self.sense()
        self.act(None if observation is None or self.policy is None else self.policy.step(observation))

    def sense(self) -> Float32s | None:
        """Read and estimate; the observation (B, N) when the policy is due, else None."""
        sample = self.robot.read()
        self.state = self.estimator.step(self.t, sample, self.smoother.sent)
        if self.walker:
            self.state = self.walker.step(self.t, sample, self.state)
            self._tool[:, :2] = self._base.velocity_in_base[:, :2]
            self._tool[:, 2] = self._base.angular_velocity[:, 2]
        if self.ticks % self.decimation:
            return None
        if not self.walker:
            self._look(sample)
        off = ~self.supervisor.powered
        if any_true(off):  # a robot without power wants to be where it stands
            self.action.reset(off, self.state.q)
        return self.observation.step()

    def _look(self, sample: Sample) -> None:
        """Where tool and goal are; who sees no goal, or none any more, stays where it is."""
        self._kinematics = self.fleet.kinematics(self.state.q)
        self._tool[:] = self._kinematics.tool_position
        if "goal" in sample:
            seen, old = sample["goal"].value, self.t - sample["goal"].t > UNSEEN_S
            self._goal[:] = np.where(np.isfinite(seen) & ~old[:, None], seen, self._tool)

    def act(self, action: Floats | Float32s | None) -> None:
        """Plan, check, decide and send; `action` (B, A) where the policy has spoken, else None."""
        if action is not None:
            self.action.step(action, self.smoother.q)
        stopping = self.supervisor.stopping
        self.action.hold(stopping, self.smoother.q)
        self.smoother.speed_scale = self.estimator.windings.foldback.speed_share
        planned = self.smoother.next(self.action.q, stopping)
        ahead, q_mid_stop, q_rest = self.smoother.brake(planned)
        self.verdict = self.safety.step(self.state, self.smoother.sent, planned, ahead, q_mid_stop, q_rest)
        reason = self.stop_reasons()
        at_rest = self.smoother.at_rest if any_true(stopping) else stopping  # only robots that stop are asked
        obey = self.supervisor.step(reason, at_rest)
        if any_true(reason) or not all_true(np.isfinite(planned.q)):
            # A robot that stops already has nothing refused; a stop without a number is still not sent.
            self._send(*self.obeyed_or_stop(obey & np.isfinite(planned.q).all(axis=1), planned))
        else:
            self._send(planned, self.verdict.tau)
        self._ahead, self._tau_ahead = _where(obey, ahead), self.verdict.tau_ahead
        self.task.step(self._tool, self.supervisor.running)
        self.since += 1
        self.ticks += 1

    def stop_reasons(self) -> Ints:
        """(B,) reasons to stop: of safety, of the estimator, asked for, and of actions that are not finite."""
        reason = self.verdict.reason | self.state.fault | self.asked
        if not all_true(self.action.finite):
            reason[~self.action.finite] |= _NOT_FINITE
        return reason

    def obeyed_or_stop(self, obey: Bools, planned: Setpoint) -> tuple[Setpoint, Floats]:
        """What was planned where it is obeyed; elsewhere the stop that the last tick prepared and checked."""
        tau = np.nan_to_num(np.where(obey[:, None], self.verdict.tau, self._tau_ahead))
        return self.replace_non_finite(_where(obey, planned, self._ahead)), tau

    def _send(self, setpoint: Setpoint, tau: Floats) -> None:
        self.smoother.commit(setpoint)
        told = self._nothing if self.springs else (setpoint.qd, tau)
        self.command = Command(
            q=setpoint.q,
            qd=told[0],
            tau=told[1],
            powered=self.supervisor.powered,
            current=self._current(),
        )
        self.estimator.external_torque.command(tau, self.command.powered)
        self.robot.write(self.command)

    def _current(self) -> Floats:
        """(B, n) share of each drive's current: all of it for a stop, which was checked with it."""
        fold, running = self.estimator.windings.foldback.current_share, self.supervisor.running
        return fold if all_true(running) else np.where(running[:, None], fold, 1.0)

    def replace_non_finite(self, planned: Setpoint) -> Setpoint:
        """Robots left without any plan rest where they were sent last, and lose their power."""
        lost = np.asarray(~np.isfinite(planned.q + planned.qd + planned.qdd).all(axis=1))
        if not any_true(lost):
            return planned
        self.supervisor.latch(lost & self.supervisor.powered, Reason.NOT_FINITE)
        self.smoother.hold(lost, self.smoother.q)
        return _where(~lost, planned, self.smoother.sent)

    def arm(self, ids: Bools) -> Ints:
        """Power robots where `ids` holds, drives are off, joints rest and nothing speaks against it.

        Returns:
            (B,) reasons of those that were refused, 0 elsewhere.
        """
        ids = ids & ~self.supervisor.powered
        here = Setpoint(q=self.state.q, qd=np.zeros_like(self.state.q), qdd=np.zeros_like(self.state.q))
        self.verdict = self.safety.step(self.state, here, here, here, here.q, here.q)
        reason = np.where(ids, self.verdict.reason | self.state.fault, 0)
        reason[ids & self.estimator.moving.any(axis=1)] |= _MOVING
        self.asked[ids], self.since[ids] = 0, 0
        granted = ids & (reason == 0)
        self.supervisor.arm(granted)
        self.estimator.follow(granted, self.smoother.sent, here)
        self.smoother.hold(granted, self.state.q)
        self._ahead = _where(~granted, self._ahead, here)
        self.action.reset(granted, self.state.q)
        if self.walker:
            self.task.reset(granted)  # nobody walks before
        self._forget(granted)
        return reason

    def _forget(self, ids: Bools) -> None:
        """What the policy of robots where `ids` holds remembers of another life."""
        if self.policy is not None:
            self.policy.reset(ids)

    def stop(self, reason: Reason) -> None:
        """Ask every robot for a controlled stop; arming takes it back."""
        self.asked |= np.int64(reason)

    def reset(self, ids: Bools) -> None:
        """Robots where `ids` holds begin anew, disarmed: their backend has put them somewhere else."""
        self.smoother.hold(ids, self.smoother.q)
        self.estimator.reset(ids, self.smoother.sent)
        if self.walker:
            self.walker.reset(ids)
        self.observation.reset(ids)
        self._forget(ids)
        self.supervisor.disarm(ids)
        self.task.reset(ids)
        self.asked[ids] = 0


_NOT_FINITE, _MOVING = np.int64(Reason.NOT_FINITE), np.int64(Reason.MOVING)
"""As numpy's own numbers, which are five times as fast as an enumeration's."""
_NOWHERE = Setpoint(q=np.array(np.nan), qd=np.array(np.nan), qdd=np.array(np.nan))


def _where(rows: Bools, here: Setpoint, elsewhere: Setpoint = _NOWHERE) -> Setpoint:
    """One setpoint where `rows` (B,) holds, another elsewhere; by default none, which is never sent."""
    if all_true(rows):
        return here
    pick = rows[:, None]
    return Setpoint(
        q=np.where(pick, here.q, elsewhere.q),
        qd=np.where(pick, here.qd, elsewhere.qd),
        qdd=np.where(pick, here.qdd, elsewhere.qdd),
    )
