"""Smoothers of drives that hold no angle: setpoints are predicted from the estimate, and stops have position drives."""

from typing import ClassVar

import numpy as np

from deploy.masks import any_true
from deploy.motion.prepared_stop import select
from deploy.motion.smoother import Smoother
from deploy.motion.torque_ramp import TorqueRamp
from deploy.state import DriveMode, Setpoint, State
from robots.arrays import Bools, Floats, Ints
from robots.models.fleet import Fleet
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

TAKEOVER_S = 0.1
"""s in which the drives of a stop reach their stiffness: the estimate that a stop begins at has noise, and at full
stiffness some milliradians are all the torque that a motor has."""
TAKEOVER_SHARE = 0.01
"""Share of its stiffness that a drive begins with."""


ACCELERATION_SHARE, SPEED_S = 0.8, 0.1
"""Share of a joint's acceleration that the policy may use, and s in which a speed is brought to its bound: the rest is
for the rate of the torque."""


class TorqueSmoother(Smoother):
    """Smoother of robots in torque mode.

    Targets are bounded by the motion that they would cause, and approached at the rates that the robot allows.
    While a robot follows the policy its setpoint is the state one period ahead, by forward dynamics of the nominal
    model from the estimate: safety checks it, and the stop that would begin there. Drives interpolate between torques,
    so that the mean of two torques acts in between.

    Attributes:
        ramp: torques sent.
        held: (B,) ticks for which drives have followed angles, up to those of `TAKEOVER_S`.
    """

    carried: ClassVar[tuple[str, ...]] = (*Smoother.carried, "held")
    parts: ClassVar[tuple[str, ...]] = ("ramp",)

    def __init__(self, spec: RobotSpec, drive: DriveMode, stop: DriveMode) -> None:
        """Take how drives follow the policy, and how they follow a stop."""
        robots = len(drive.mode)
        super().__init__(spec, robots)
        self.ramp, self._fleet, self._dt = TorqueRamp(spec, robots), Fleet(spec, robots), spec.dt
        self._drive, self._stop, self._rate = drive, stop, np.zeros((robots, spec.n))
        self._qdd_max = ACCELERATION_SHARE * spec.joint_array("qdd_max")
        self._qd_max = (
            ACCELERATION_SHARE * spec.margins.speed_in(ControlMode.TORQUE) * spec.joint_array("qd_max")
        )
        self._takeover = round(TAKEOVER_S / spec.dt)
        self.held = np.full(robots, self._takeover)

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
        ahead = Setpoint(q=q, qd=qd, qdd=qdd, tau=tau, drive=self._drive)
        if not any_true(stopping):
            return ahead
        return select(~stopping, ahead, self._as_stop(self.next(self.q, stopping), self.held))

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

    def brake(self, start: Setpoint) -> tuple[Setpoint, Floats, Floats]:
        """Return the stop that would begin at `start`, as `Smoother.brake`, with position drives."""
        stop, q_mid_stop, q_rest = super().brake(start)
        return self._as_stop(stop, np.zeros_like(self.held)), q_mid_stop, q_rest

    def _as_stop(self, setpoint: Setpoint, held: Ints) -> Setpoint:
        """Return a setpoint for position drives that have been so for `held` (B,) ticks."""
        drive = self._stop
        if any_true(held < self._takeover):
            share = TAKEOVER_SHARE ** (1.0 - held / self._takeover)[:, None]
            # With the square root of its factor the damping ratio stays.
            drive = DriveMode(mode=drive.mode, kp=drive.kp * share, kd=drive.kd * np.sqrt(share))
        return setpoint._replace(tau=np.full_like(setpoint.q, np.nan), drive=drive)

    def commit(self, sent: Setpoint) -> None:
        """Remember what was sent, torques included."""
        super().commit(sent)
        if sent.tau is None or sent.drive is None:
            return
        followed = np.asarray(sent.drive.mode == ControlMode.TORQUE)
        self.ramp.commit(sent.tau, self._rate, followed)
        self.held[:] = np.where(followed, 0, np.minimum(self.held + 1, self._takeover))
