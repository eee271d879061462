"""Fault detections of joints: filters that do not agree with their samples, and encoders that repeat one value."""

import numpy as np

from deploy.estimation.joint_filter import GATE, JointFilter
from deploy.estimation.sample_count import sample_count
from deploy.masks import all_true
from deploy.stage import Stage
from robots.arrays import Bools, Floats
from robots.models.nominal_model import torque_max
from robots.motors.gains import Gains
from robots.spec import RobotSpec

CONFIRMED_S = 0.05
"""s of accepted samples after which a filter is confirmed. Before that, a sample outside the gate restarts it."""
REFUSED_S = 0.1
"""s of samples in a row outside the gate after which a filter is restarted."""
NIS_S = 0.25
"""s of samples in the running mean of the normalized innovation squared (NIS)."""
NIS_MAX = 9.0
"""Mean NIS above which a filter has diverged; 1 is expected."""
STUCK_S = 0.1
"""s for which a stuck encoder has repeated its value."""
STUCK_STD = 10.0
"""Standard deviations of the encoder's noise by which the setpoint must have moved meanwhile."""
STUCK_SHARE = 0.3
"""On soft drives: share of the joint's torque that this motion must demand; less need not move a loaded leg."""


class Divergence(Stage):
    """Sample counts and running mean NIS of B × n filters.

    Attributes:
        nis: (B, n) running mean of the NIS.
        accepted: (B, n) samples fused since the filter was started. refused: (B, n) samples in a row outside the gate.
    """

    carried = ("nis", "accepted", "refused")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        shape, period_s = (robots, spec.n), 1.0 / spec.sensors["encoder"].rate_hz
        self.nis = np.zeros(shape)
        self.accepted, self.refused = np.zeros((2, *shape), dtype=np.int64)
        self.confirmed_samples = sample_count(CONFIRMED_S, period_s)
        self.refused_samples = sample_count(REFUSED_S, period_s)
        self.nis_samples = sample_count(NIS_S, period_s)

    def restart(self, joints: Bools) -> None:
        """Count from the sample that started the filters of `joints` (B, n)."""
        self.accepted[joints], self.refused[joints] = 1, 0

    def step(self, nis: Floats, new: Bools, fused: Bools) -> Bools | None:
        """Count samples that arrived (`new`) and those inside the gate (`fused`), with their NIS; all (B, n).

        Returns the filters (B, n) that must be restarted from this sample; None if all samples were fused.
        """
        self.accepted += fused
        if all_true(fused):
            self.nis += (nis - self.nis) / self.nis_samples
            self.refused[:] = 0
            return None
        np.add(self.nis, (np.minimum(nis, GATE**2) - self.nis) / self.nis_samples, out=self.nis, where=new)
        outside = new & ~fused
        self.refused += outside
        self.refused[fused] = 0
        return outside & ((self.accepted < self.confirmed_samples) | (self.refused >= self.refused_samples))

    @property
    def confirmed(self) -> Bools:
        """(B, n) filters with enough accepted samples to be used."""
        confirmed: Bools = self.accepted >= self.confirmed_samples
        return confirmed

    def diverged(self, joints: JointFilter) -> Bools:
        """Return (B, n) filters whose mean NIS is above its limit or whose covariance is not finite."""
        return np.asarray(~((self.nis <= NIS_MAX) & np.isfinite(joints.p00 + joints.p11)))


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
