"""Smoothers of drives that hold no angle: setpoints follow from the estimate, and stops have position drives."""

from typing import ClassVar

import numpy as np

from deploy.masks import any_true
from deploy.motion.prepared_stop import select
from deploy.motion.smoother import Smoother, VelocitySmoother
from deploy.motion.takeover import Takeover
from deploy.motion.torque_ramp import TorqueRamp
from deploy.state import DriveMode, Setpoint, State, Stop
from robots.arrays import Bools, Floats
from robots.capabilities import required
from robots.models.fleet import Fleet
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

ACCELERATION_SHARE, SPEED_S = 0.8, 0.1
"""Share of a joint's acceleration that the policy may use, and s in which a speed is brought to its bound: the rest is
for the rate of the torque."""


class TakingOver(Smoother):
    """Smoother whose stops have position drives, which take over from drives of the policy that hold no angle."""

    takeover: Takeover

    @property
    def stopped(self) -> Bools:
        """(B,) robots at rest after `TAKEOVER_S`: until then, soft drives let a joint move, and brakes jerk it."""
        return super().stopped & self.takeover.complete

    def brake(self, start: Setpoint) -> Stop:
        """Return the stop that would begin at `start`, as `Smoother.brake`, with position drives."""
        stop = super().brake(start)
        drive = self.takeover.drive_after(required(start.drive))
        return stop._replace(ahead=stop.ahead._replace(drive=drive))

    def hold(self, ids: Bools, q: Floats) -> None:
        """Put robots at rest, as `Smoother.hold`, with the stiff drives of a stop."""
        super().hold(ids, q)
        self.takeover.end(ids)


class RollingSmoother(TakingOver, VelocitySmoother):
    """Smoother of robots in velocity mode with wheels: joints without stiffness, which slip behind their setpoints.

    While a robot follows the policy, each of those joints goes on from its estimated angle, at the speed sent.
    """

    parts: ClassVar[tuple[str, ...]] = ("takeover",)

    def __init__(self, spec: RobotSpec, drive: DriveMode, stop: DriveMode) -> None:
        """Take how drives follow the policy, and how they follow a stop."""
        super().__init__(spec, len(drive.mode), drive)
        self._free, self.takeover = drive.kp == 0.0, Takeover(spec, drive, stop)

    def plan(self, target: Floats, stopping: Bools, state: State) -> Setpoint:
        """Return the next setpoint of every robot, as `Smoother.next`; drives of a stop become stiff."""
        np.copyto(self.q, state.q, where=self._free & ~stopping[:, None])
        planned = self.next(target, stopping)
        return select(~stopping, planned, planned._replace(drive=self.takeover.drive))

    def commit(self, sent: Setpoint) -> None:
        """Remember what was sent, and how."""
        super().commit(sent)
        self.takeover.commit(required(sent.drive))


class TorqueSmoother(TakingOver):
    """Smoother of robots in torque mode.

    Targets are bounded by the motion that they would cause, and approached at the rates that the robot allows.
    While a robot follows the policy its setpoint is the state one period ahead, by forward dynamics of the nominal
    model from the estimate: safety checks it, and the stop that would begin there. Drives interpolate between torques,
    so that the mean of two torques acts in between.

    Attributes:
        ramp: torques sent. takeover: drives of stops.
    """

    parts: ClassVar[tuple[str, ...]] = ("ramp", "takeover")

    def __init__(self, spec: RobotSpec, drive: DriveMode, stop: DriveMode) -> None:
        """Take how drives follow the policy, and how they follow a stop."""
        robots = len(drive.mode)
        super().__init__(spec, robots, drive)
        self.ramp, self._fleet, self._dt = TorqueRamp(spec, robots), Fleet(spec, robots), spec.dt
        self._rate = np.zeros((robots, spec.n))
        self.takeover = Takeover(spec, drive, stop)
        self._qdd_max = ACCELERATION_SHARE * spec.joint_array("qdd_max")
        self._qd_max = (
            ACCELERATION_SHARE * spec.margins.of(ControlMode.TORQUE).speed * spec.joint_array("qd_max")
        )

    @property
    def target_at_rest(self) -> Floats:
        """(B, n) N·m, the torque sent last."""
        return self.ramp.tau

    def plan(self, target: Floats, stopping: Bools, state: State) -> Setpoint:
        """Return the predicted state of robots that follow the policy, and the stop of the others."""
        tau, self._rate = self.ramp.next(self._bounded(target, state))
        qdd = self._fleet.acceleration(state.q, state.qd, 0.5 * (self.ramp.tau + tau))
        qd = state.qd + qdd * self._dt
        q = state.q + 0.5 * (state.qd + qd) * self._dt
        ahead = Setpoint(q=q, qd=qd, qdd=qdd, tau=tau, drive=self.drive)
        if not any_true(stopping):
            return ahead
        stop = self.next(self.q, stopping)
        drive = self.takeover.drive_in_range(stop, state, self.ramp.tau)
        return select(~stopping, ahead, _as_stop(stop, drive))

    def _bounded(self, target: Floats, state: State) -> Floats:
        """Return torques that cause no more acceleration than allowed, nor a speed that leaves no way to brake."""
        q, qd = state.q, state.qd
        wanted = self._fleet.acceleration(q, qd, self.ramp.clamped(target))
        up, down = (
            np.sqrt(self._qdd_max * np.maximum(room, 0.0)) for room in (self.q_max - q, q - self.q_min)
        )
        fastest, slowest = np.minimum(up, self._qd_max), -np.minimum(down, self._qd_max)
        high = np.clip((fastest - qd) / SPEED_S, -self._qdd_max, self._qdd_max)
        low = np.clip((slowest - qd) / SPEED_S, -self._qdd_max, self._qdd_max)
        qdd = np.minimum(np.maximum(wanted, low), high)
        return self._fleet.torque(q, qd, qdd) + self._fleet.friction(qd)

    def brake(self, start: Setpoint) -> Stop:
        """Return the stop that would begin at `start`, as `TakingOver.brake`; safety computes its torque."""
        stop = super().brake(start)
        return stop._replace(ahead=_as_stop(stop.ahead, required(stop.ahead.drive)))

    def commit(self, sent: Setpoint) -> None:
        """Remember what was sent, torques included."""
        super().commit(sent)
        drive = required(sent.drive)
        self.ramp.commit(required(sent.tau), self._rate, np.asarray(drive.mode == ControlMode.TORQUE))
        self.takeover.commit(drive)


def _as_stop(setpoint: Setpoint, drive: DriveMode) -> Setpoint:
    return setpoint._replace(tau=np.full_like(setpoint.q, np.nan), drive=drive)
