"""One control tick: read, estimate, observe, run the policy, plan, check, decide, send. For any number of robots."""

from collections.abc import Mapping, Sequence
from typing import cast
from weakref import proxy

import numpy as np
from numpy.typing import NDArray

from deploy.backends.backend import Robot
from deploy.estimation.capabilities import CapabilityEstimators
from deploy.estimation.estimator import Estimator
from deploy.estimation.resting_angles import RestingAngles
from deploy.estimation.tool_kinematics import ToolKinematics
from deploy.masks import all_true, any_true
from deploy.motion.drive_law import SpringDrives, drive_law
from deploy.motion.drive_modes import drive_modes
from deploy.motion.prepared_stop import PreparedStop, select
from deploy.motion.smoothers import make_smoother
from deploy.motion.soft_start import soft_start
from deploy.policy.action import Action
from deploy.policy.actor import Actor
from deploy.policy.contract import Contract
from deploy.policy.observation import Observation
from deploy.reasons import Reason
from deploy.safety.escalation import StopEscalation
from deploy.safety.safety import Safety
from deploy.safety.supervisor import Supervisor
from deploy.stage import Arrays, Stage
from deploy.state import STOP_MOMENTS, BaseState, Command, Sample, Setpoint, State, Stop, Target, Verdict
from deploy.tasks.task import Task, find_task, sources_of
from robots.arrays import Bools, Float32s, Floats, Ints
from robots.capabilities import required
from robots.models.fleet import Fleet
from robots.motors.control_mode import ControlMode
from robots.motors.drive_gains import drive_gains
from robots.spec import RobotSpec

_NOT_FINITE, _MOVING, _REPEATED = (
    np.int64(reason) for reason in (Reason.NOT_FINITE, Reason.MOVING, Reason.REPEATED)
)
"""Bits as np.int64, which are five times as fast in array expressions as members of an enumeration."""


class Runtime(Stage):
    """Stages of the tick for B robots.

    `sense` and `act` are the two halves of a tick; a policy, shipped or in training, sits between them. After a tick
    its records can be read: `sample`, `state`, `target`, `verdict`, `setpoint`, `command`; after `restore` they are
    invalid until the next tick. `save` holds all state but that of the robots themselves.

    Attributes:
        ticks: control ticks so far. decimation: control ticks for each step of the policy.
        requested_stop: (B,) bit sets of `Reason` that `stop` was called with. ticks_since_arming: (B,).
    """

    carried = ("requested_stop", "ticks_since_arming")
    parts = (
        *("estimator", "resting", "action", "smoother", "supervisor", "task", "observation"),
        *("capabilities", "prepared_stop", "escalation"),
    )

    sample: Sample
    state: State
    verdict: Verdict
    command: Command
    action: Action

    def __init__(
        self,
        spec: RobotSpec,
        contract: Contract,
        robot: Robot,
        seeds: Sequence[np.random.SeedSequence],
        policy: Actor | None = None,
    ) -> None:
        """Build every stage; nothing moves until `arm`.

        Args:
            spec: the robot.
            contract: of the policy, checked against `spec` beforehand.
            robot: opened by a backend, B robots wide.
            seeds: B seeds, from which each robot's goals follow.
            policy: or another actor in its place; None where the caller puts its own between `sense` and `act`.
        """
        self.spec, self.contract, self.robot, self.policy = spec, contract, robot, policy
        robots, mode, gains = robot.robots, contract.action.control_mode, contract.action.gains
        self.ticks, self.decimation = 0, contract.control_hz // contract.policy_hz
        in_mode = spec.in_mode(mode)
        fleet = Fleet(in_mode, 2 * robots, collisions=True)
        self.drives = drive_modes(spec, mode, gains, robots)
        self.law = law = drive_law(spec, mode, gains, fleet)
        self.springs = law if isinstance(law, SpringDrives) else None
        self.estimator = Estimator(spec, robots, springs=gains if self.springs else None)
        self.resting = RestingAngles(spec, robots)
        self.capabilities = CapabilityEstimators(spec, robots)
        self.safety = Safety(spec, fleet, law, mode=mode)
        self.action = Action(contract.action, self.drives.policy)
        self.smoother = make_smoother(spec, self.drives)
        self.prepared_stop = PreparedStop(self.drives)
        self.supervisor, self.escalation = Supervisor(robots, spec.dt), StopEscalation(spec, robots)
        self.task: Task = find_task(contract.task, f"contract: task {contract.task!r}")(in_mode, seeds)
        sources = sources_of(contract.task)
        seen = proxy(self)  # a reader must not keep the runtime, and its robots, in memory
        readers = {term.source: sources[term.source].reader(seen) for term in contract.observation}
        self.observation = Observation(contract, readers, robots)
        self.requested_stop, self.ticks_since_arming = np.zeros((2, robots), dtype=np.int64)
        self._zeros, self._own_kp = np.zeros((robots, spec.n)), drive_gains(spec).kp
        if policy is not None:
            policy.resize(robots)

    def stages(self) -> dict[str, Stage]:
        """Every stage with state, the policy's memory included."""
        return super().stages() | ({} if self.policy is None else {"policy": self.policy})

    def save(self) -> Arrays:
        """Copies of all arrays of all stages, and the number of ticks."""
        return super().save() | {"ticks": np.array(self.ticks)}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back, bit for bit."""
        super().restore(arrays)
        self.ticks = int(arrays["ticks"])

    @property
    def t(self) -> float:
        """s, time of the coming tick."""
        return self.ticks * self.spec.dt

    @property
    def target(self) -> Target:
        """Target of the policy, before any limit."""
        return self.action.target

    @property
    def setpoint(self) -> Setpoint:
        """Setpoint that was sent last, with the mode, stiffness and damping of the drives."""
        return self.smoother.sent

    @property
    def base(self) -> BaseState:
        """Estimate of the floating base; only for robots with one."""
        if self.state.base is None:
            raise RuntimeError(f"{self.spec.name} has no floating base")
        return self.state.base

    @property
    def tool(self) -> ToolKinematics:
        """Tool at the estimated joint angles; only for robots with one."""
        if "tool" not in self.capabilities.by_name:
            raise RuntimeError(f"{self.spec.name} has no tool")
        return cast(ToolKinematics, self.capabilities.by_name["tool"])

    def tick(self) -> None:
        """Sense, run the policy when it is due, act."""
        observation = self.sense()
        self.act(None if observation is None or self.policy is None else self.policy.step(observation))

    def skip(self, slots: Ints) -> None:
        """Expect robots whose coming tick is `slots` (B,) late to have gone on by themselves for so long."""
        self.estimator.late_ticks.skip(slots, self.smoother.sent.qd, self.estimator.joints)

    def sense(self) -> Float32s | None:
        """Read and estimate; return the observation (B, N) when the policy is due, else None."""
        t, due = self.t, self.ticks % self.decimation == 0
        self.sample = sample = self.robot.read()
        state = self.estimator.step(t, sample, self.smoother.sent)
        self.state = self.capabilities.step(t, sample, state, due)
        if any_true(off := ~self.supervisor.powered):
            measured = state.age <= self.spec.margins.stale_s  # without samples, an estimate drifts
            self.resting.step(state.q, off & measured & ~self.estimator.moving.any(axis=1))
        self.task.observe(self, sample, due)
        if not due:
            return None
        if any_true(off):  # the target of a robot without power follows its joints
            self.action.reset(off, self._target_at_rest(self.state.q))
        return self.observation.step()

    def act(self, action: Floats | Float32s | None) -> None:
        """Plan, check, decide and send.

        Args:
            action: (B, A) of the policy if it was due, else None.
        """
        if action is not None:
            self.action.step(action, self.smoother.q)
        stopping = self.supervisor.stopping
        self.action.hold(stopping, self.smoother.target_at_rest)
        self.smoother.speed_share = self.estimator.windings.foldback.speed_share
        planned = self.smoother.plan(self.action.value, stopping, self.state)
        stop = self.smoother.brake(planned)
        self.verdict = self.safety.step(self.state, self.smoother.sent, planned, stop)
        reason = self.stop_reasons()
        at_rest = stopped = stopping  # all False while none stops
        if any_true(stopping):
            at_rest, stopped = self.smoother.at_rest, self.smoother.stopped
        send_planned = self.supervisor.step(reason, at_rest, stopped)
        setpoint, tau = planned, self.verdict.tau
        if any_true(reason) or not all_true(np.isfinite(planned.q)):
            # A stopping robot keeps sending its plan even if that is refused; one that is not finite is never sent.
            finite = np.isfinite(planned.q).all(axis=1)
            setpoint, tau = self.select_setpoint(send_planned & finite, planned)
        running = self.supervisor.running
        self._send(setpoint, tau, running)
        self.prepared_stop.prepare(send_planned, stop.ahead, self.verdict.tau_ahead)
        self.task.step(running)
        self.ticks_since_arming += 1
        self.ticks += 1

    def stop_reasons(self) -> Ints:
        """(B,) bit sets of all reasons to refuse the planned setpoint."""
        reason = self.verdict.reason | self.state.fault | self.requested_stop
        if not all_true(self.action.finite):
            reason[~self.action.finite] |= _NOT_FINITE
        begins = self.supervisor.running & (reason != 0)
        if any_true(begins):
            reason[self.escalation.step(self.ticks, begins, self.task.reached)] |= _REPEATED
        return reason

    def select_setpoint(self, send_planned: Bools, planned: Setpoint) -> tuple[Setpoint, Floats]:
        """Return setpoint and torque as planned where `send_planned` holds, elsewhere those of the prepared stop."""
        tau = np.nan_to_num(np.where(send_planned[:, None], self.verdict.tau, self.prepared_stop.tau))
        return self.cut_power_without_plan(select(send_planned, planned, self.prepared_stop.setpoint)), tau

    def cut_power_without_plan(self, planned: Setpoint) -> Setpoint:
        """Cut power of robots without any finite plan; they rest at the setpoint sent last."""
        unplanned = np.asarray(~np.isfinite(planned.q + planned.qd + planned.qdd).all(axis=1))
        if not any_true(unplanned):
            return planned
        self.supervisor.latch(unplanned & self.supervisor.powered, Reason.NOT_FINITE)
        self.smoother.hold(unplanned, self.smoother.q)
        return select(~unplanned, planned, self.smoother.sent)

    def _target_at_rest(self, q: Floats) -> Floats:
        """Return the target (B, n) of robots that rest at q (B, n) rad: these angles, or speeds and torques of 0."""
        return q if self.contract.action.control_mode is ControlMode.POSITION else self._zeros

    def _send(self, setpoint: Setpoint, tau: Floats, running: Bools) -> None:
        tau = self.law.limited(tau)
        if self.drives.free:
            setpoint = setpoint._replace(tau=tau)
        self.smoother.commit(setpoint)
        qd, feed_forward = (self._zeros, self._zeros) if self.springs else (setpoint.qd, tau)
        powered, share = self.supervisor.powered, self.estimator.windings.foldback.current_share
        if not all_true(running):  # heat limits current while running only: a stop has what its drives allow
            share = np.where(running[:, None], share, 1.0)
        if self.law.current_share < 1.0:
            share = np.minimum(share, self.law.current_share)
        drive = required(setpoint.drive)
        sent = drive
        if not self.spec.base:
            sent = soft_start(drive, self._own_kp, self.ticks_since_arming, self.spec.dt)
        self.command = Command(sent, setpoint.q, qd, feed_forward, powered, share)
        self.estimator.external_torque.command(tau, powered)
        self.robot.write(self.command)
        if self.drives.free:
            torque_mode = self.contract.action.control_mode is ControlMode.TORQUE
            self.estimator.joints.follow_drives((drive.kp < self.drives.stop.kp) & powered[:, None])
            self.estimator.follow_joints(drive.kp == 0.0, self.t, speeds=torque_mode)

    @property
    def moving(self) -> Bools:
        """(B, n) joints that move or creep without power; legs on a floor may creep, as they settle in soft drives."""
        moving = self.estimator.moving
        return moving if self.spec.base else moving | self.resting.creeping(self.state.q)

    def arm(self, ids: Bools) -> Ints:
        """Power robots where `ids` holds, drives are off, joints rest and every check passes.

        Setpoints of robots on a fixed base begin at the mean of all estimates since the joints came to rest, those of
        others at the last estimate.

        Returns:
            (B,) reasons of those that were refused, 0 elsewhere.
        """
        off = ~self.supervisor.powered
        ids = ids & off
        q = self.state.q if self.spec.base else np.where(off[:, None], self.resting.q, self.state.q)
        here = Setpoint(q=q, qd=np.zeros_like(q), qdd=np.zeros_like(q))
        # At rest a stop is the pose itself.
        still = np.array([here.qd] * STOP_MOMENTS)
        stop = Stop(here, q=np.array([q] * STOP_MOMENTS), qd=still, qdd=still, q_rest=q)
        self.verdict = self.safety.step(self.state, here, here, stop)
        reason = np.where(ids, self.verdict.reason | self.state.fault, 0)
        reason[ids & self.moving.any(axis=1)] |= _MOVING
        self.requested_stop[ids], self.ticks_since_arming[ids] = 0, 0
        granted = ids & (reason == 0)
        self.resting.ticks[granted] = 0
        self.supervisor.arm(granted)
        self.escalation.reset(granted)
        self.estimator.follow(granted, self.smoother.sent, here)
        self.smoother.hold(granted, here.q)
        self.prepared_stop.rest(granted, here)
        self.action.reset(granted, self._target_at_rest(here.q))
        self.task.arm(granted)
        self._reset_policy(granted)
        return reason

    def _reset_policy(self, ids: Bools) -> None:
        if self.policy is not None:
            self.policy.reset(ids)

    def stop(self, reason: Reason, ids: Bools | None = None) -> None:
        """Request a controlled stop of robots where `ids` (B,) holds, by default of all; arming clears it."""
        self.requested_stop[slice(None) if ids is None else ids] |= np.int64(reason)

    def reset(self, ids: Bools) -> None:
        """Reset and disarm robots where `ids` (B,) holds, which their backend has moved."""
        self.smoother.hold(ids, self.smoother.q)
        self.estimator.reset(ids, self.smoother.sent)
        self.resting.ticks[ids] = 0
        self.capabilities.reset(ids)
        self.observation.reset(ids)
        self._reset_policy(ids)
        self.supervisor.disarm(ids)
        self.task.reset(ids)
        self.requested_stop[ids] = 0
