"""Position drives of a stop that take over from drives that hold no angle, and become stiff."""

from typing import ClassVar

import numpy as np

from deploy.masks import any_true
from deploy.stage import Stage
from deploy.state import DriveMode, Setpoint, State
from robots.arrays import Bools, Floats, Ints
from robots.models.joint_inertia import joint_inertia
from robots.models.nominal_model import torque_max
from robots.spec import RobotSpec

TAKEOVER_S = 0.3
"""s in which the drives of a stop reach their stiffness: the estimate that a stop begins at has noise, and lags behind
an arm that is pushed. At full stiffness some milliradians are all the torque that a motor has."""
TAKEOVER_SHARE, DAMPING_SHARE = 0.01, 0.316
"""Shares of its stiffness and its damping that a drive begins with. With 0.1 of the damping the damping ratio would
stay; with more, a drive removes the difference in speed first, then pulls the joint to its angle."""
DAMPING_RATE = 60.0
"""1/s. Most damping that a drive begins with, per inertia of its joint: a push moves a light joint by more than its
estimate, which is 40 ms behind, and further if packets are lost."""
RANGE_SHARE = 0.9
"""Share of its motor's range up to which a drive stiffens. Damping alone may take as much, and is not reduced."""
FALL_S = 0.022
"""s, time constant with which a drive becomes softer at most: one noisy estimate must not make it soft."""
TINY_RAD = 1e-9
"""rad. A smaller error needs no limit of stiffness."""


class Takeover(Stage):
    """Drives of a stop, which take over from drives of the policy that hold no angle, and become stiff.

    Attributes:
        held: (B,) ticks for which drives have followed angles, up to those of `TAKEOVER_S`.
        kp: (B, n) N·m/rad, stiffness of the drives sent last.
    """

    carried: ClassVar[tuple[str, ...]] = ("held", "kp")

    def __init__(self, spec: RobotSpec, policy: DriveMode, stop: DriveMode) -> None:
        self._policy, self._stop, self._free = policy, stop, policy.kp == 0.0
        self._ticks, self._torque = round(TAKEOVER_S / spec.dt), RANGE_SHARE * torque_max(spec)
        self._rise, self._fall = TAKEOVER_SHARE ** (-1.0 / self._ticks), np.exp(-spec.dt / FALL_S)
        most = DAMPING_RATE * joint_inertia(spec).most
        self._damping = DAMPING_SHARE * most / np.maximum(DAMPING_SHARE * stop.kd, most)
        self.held, self.kp = np.full(len(stop.mode), self._ticks), stop.kp.copy()

    @property
    def drive(self) -> DriveMode:
        """Drives of a robot that stops now."""
        return self._after(self.held)

    def drive_in_range(self, stop: Setpoint, state: State, tau: Floats) -> DriveMode:
        """Return drives of robots that stop now, no stiffer than keeps their motors inside `RANGE_SHARE`.

        While drives are soft, a push or a payload carries an arm beyond its setpoint. Stiffness that rises whatever
        comes would pull it back with all of the motors' torque. kp is the highest, from that of the first tick to
        that of now, for which

            |tau + kp (q* − q) + kd (q̇* − q̇)| <= RANGE_SHARE of the range

        by the estimate. That has noise: whatever it says, kp rises by no more in a tick than without this limit, and
        falls by no more than `FALL_S` lets it. A state that is not finite limits nothing.

        Args:
            stop: setpoints to be sent. state: the estimate. tau: (B, n) N·m, fed forward last.
        """
        drive, error = self.drive, stop.q - state.q
        left = self._torque - np.sign(error) * (tau + drive.kd * (stop.qd - state.qd))
        kp = np.fmin(drive.kp, left / np.maximum(np.abs(error), TINY_RAD))
        kp = np.clip(kp, self._fall * self.kp, self._rise * self.kp)
        return drive._replace(kp=np.maximum(kp, TAKEOVER_SHARE * self._stop.kp))

    def drive_after(self, sent: DriveMode) -> DriveMode:
        """Return drives of robots whose stop begins when the drives `sent` were those of the last setpoint.

        After angles, kp rises from what was sent, as in `drive_in_range`.
        """
        followed = sent.mode == self._policy.mode
        drive = self._after(np.where(followed, 0, self.held))
        most = np.where(followed[:, None], np.inf, self._rise * sent.kp)
        return drive._replace(kp=np.minimum(drive.kp, most))

    @property
    def complete(self) -> Bools:
        """(B,) robots whose drives have followed angles for `TAKEOVER_S`; under a load they may still be softer."""
        return np.asarray(self.held == self._ticks)

    def _after(self, held: Ints) -> DriveMode:
        """Return position drives that have been so for `held` (B,) ticks."""
        if not any_true(held < self._ticks):
            return self._stop
        left = np.where(self._free, (1.0 - held / self._ticks)[:, None], 0.0)
        kp, kd = self._stop.kp * TAKEOVER_SHARE**left, self._stop.kd * self._damping**left
        return self._stop._replace(kp=kp, kd=kd)

    def end(self, ids: Bools) -> None:
        """Drives of robots in `ids` (B,) have their whole stiffness."""
        self.held[ids], self.kp[ids] = self._ticks, self._stop.kp[ids]

    def commit(self, sent: DriveMode) -> None:
        """Count a tick in which robots had the drives `sent`: those of the policy, or of a stop."""
        followed = sent.mode == self._policy.mode
        self.held[:] = np.where(followed, 0, np.minimum(self.held + 1, self._ticks))
        self.kp[:] = sent.kp
