"""Fault detection of joints: encoders that repeat one value."""

import numpy as np

from deploy.estimation.sample_count import sample_count
from deploy.stage import Stage
from robots.arrays import Bools, Floats
from robots.models.nominal_model import torque_max
from robots.motors.gains import Gains
from robots.spec import RobotSpec

STUCK_S = 0.1
"""s for which a stuck encoder has repeated its value."""
STUCK_STD = 10.0
"""Standard deviations of the encoder's noise by which the setpoint must have moved meanwhile."""
STUCK_SHARE = 0.3
"""On soft drives: share of the joint's torque that this motion must demand; less need not move a loaded leg."""


class StuckDetection(Stage):
    """Repeated encoder values of B × n joints.

    Attributes:
        value: (B, n) rad, encoder value at the last look. setpoint: (B, n) rad, setpoint when it was first seen.
        repeats: (B, n) looks with a fused sample since then.
    """

    carried = ("value", "setpoint", "repeats")

    def __init__(self, spec: RobotSpec, robots: int, look_s: float, springs: Gains | None) -> None:
        """Allocate; `look_s` is the period of `look`, `springs` are the gains of soft drives."""
        self.value, self.setpoint = np.zeros((2, robots, spec.n))
        self.repeats = np.zeros((robots, spec.n), dtype=np.int64)
        self.looks = sample_count(STUCK_S, look_s)
        self._distance = np.full(spec.n, STUCK_STD * np.sqrt(spec.sensors["encoder"].variance))
        if springs:
            self._distance = STUCK_SHARE * torque_max(spec) / springs.kp

    def look(self, value: Floats, setpoint: Floats, fused: Bools) -> None:
        """Compare encoder values (B, n) rad with those of the last look, where `fused` (B, n).

        `setpoint` (B, n) rad: at the time when the values were taken.
        """
        changed = fused & (value != self.value)
        np.copyto(self.value, value, where=changed)
        np.copyto(self.setpoint, setpoint, where=changed)
        self.repeats += fused
        np.copyto(self.repeats, 0, where=changed)

    @property
    def repeated(self) -> Bools:
        """(B, n) encoders that have repeated their value for `STUCK_S`."""
        return np.asarray(self.repeats >= self.looks)

    def stuck(self, setpoint: Floats) -> Bools:
        """Return (B, n) encoders that repeat their value although the setpoint, now at (B, n) rad, moved."""
        return np.asarray(self.repeated & (np.abs(setpoint - self.setpoint) > self._distance))
