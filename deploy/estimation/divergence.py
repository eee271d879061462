"""Consistency of each joint's filter with its samples: confirmation, restart and divergence."""

import numpy as np

from deploy.estimation.joint_filter import GATE, JointFilter
from deploy.estimation.sample_count import sample_count
from deploy.masks import all_true
from deploy.stage import Stage
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec

CONFIRMED_S = 0.05
"""s of accepted samples after which a filter is confirmed. Before that, a sample outside the gate restarts it."""
REFUSED_S = 0.1
"""s of samples in a row outside the gate after which a filter is restarted."""
NIS_S = 0.25
"""s of samples in the running mean of the normalized innovation squared (NIS)."""
NIS_MAX = 9.0
"""Mean NIS above which a filter has diverged; 1 is expected."""


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
