"""Fault detections of a floating base: IMU readings that repeat themselves, and a filter that has diverged.

A filter has diverged when it is uncertain, or contradicted by its feet or by the IMU's own orientation.
"""

import numpy as np

from deploy.estimation.floating_base.base_model import V, diagonal
from deploy.estimation.sample_count import sample_count
from deploy.stage import Stage
from robots.arrays import Bools, Floats

RANGE = 1e4
"""rad/s, m/s² or m: a reading beyond it is invalid."""
STUCK_S = 0.05
"""s of equal samples in a row, which no noise explains."""
GATE = 16.27
"""Normalized innovation squared (NIS) above which a foot is left out: χ² with 3 degrees of freedom, 1 of 1000."""
NIS_S, NIS_MAX = 1.5, 4 * GATE
"""s of the running mean of the best foot's NIS, and the largest value that one sample may add to it."""
CONTRADICTED_S = 0.08
"""s of measured tilts in a row outside the gate: a blow to the IMU is over by then."""
TILT_STD_MAX, SPEED_STD_MAX = 0.5, 2.0
"""rad, m/s: standard deviations above which the base is lost."""


class ImuCheck(Stage):
    """Equal samples in a row.

    Attributes:
        repeats: (B, 2) of gyro and accelerometer, for one of them may be stuck alone.
    """

    carried = ("repeats",)

    def __init__(self, dt: float, robots: int) -> None:
        """Allocate; dt is the period of samples in s."""
        self.repeats = np.zeros((robots, 2), dtype=np.int64)
        self.samples = sample_count(STUCK_S, dt)

    def step(self, new: Bools, reading: Floats, last: Floats) -> None:
        """Compare readings (B, 6) with the last ones where `new` (B, 2): a sensor without new samples is not stuck."""
        same = (reading == last).reshape(-1, 2, 3).all(axis=2)
        np.copyto(self.repeats, (self.repeats + 1) * same, where=new)

    @property
    def stuck(self) -> Bools:
        """(B,) robots whose gyro or accelerometer repeats itself."""
        return np.asarray((self.repeats >= self.samples - 1).any(axis=1))


def in_range(*readings: Floats) -> Bools:
    """Return True where all numbers along the last axis are finite and inside ±`RANGE`."""
    return np.asarray((np.abs(np.concatenate(readings, axis=-1)) <= RANGE).all(axis=-1))


class BaseDivergence(Stage):
    """Consistency of B filters with their measurements.

    Attributes:
        nis: (B,) running mean of the NIS of the best foot. contradictions: (B,) tilts in a row outside the gate.
    """

    carried = ("nis", "contradictions")

    def __init__(self, robots: int, look_s: float, tilt_s: float) -> None:
        """Allocate; `look_s` and `tilt_s` are the periods of `add_feet` and `add_tilt`."""
        self.nis, self.contradictions = np.zeros(robots), np.zeros(robots, dtype=np.int64)
        self.nis_samples = sample_count(NIS_S, look_s)
        self.contradictions_max = sample_count(CONTRADICTED_S, tilt_s)

    def reset(self, ids: Bools) -> None:
        """Forget robots `ids` (B,)."""
        self.nis[ids], self.contradictions[ids] = 0.0, 0

    def add_feet(self, nis: Floats, stands: Bools) -> None:
        """Add the NIS (B, F) of the feet that stand (B, F)."""
        best = np.where(stands, np.minimum(nis, NIS_MAX), NIS_MAX).min(axis=1)
        self.nis += np.where(stands.any(axis=1), (best - self.nis) / self.nis_samples, 0.0)

    def add_tilt(self, measured: Bools, used: Bools) -> None:
        """Count measured tilts (B,) that were not `used` (B,)."""
        self.contradictions += measured & ~used
        self.contradictions[used] = 0

    def consistent(self, P: Floats) -> Bools:
        """Return (B,) filters that may be used, given their covariance P (B, 12, 12)."""
        var = diagonal(P)
        tilt_var, speed_var = var[:, :2].sum(axis=1), var[:, V].max(axis=1)
        known = (tilt_var <= TILT_STD_MAX**2) & (speed_var <= SPEED_STD_MAX**2) & (self.nis <= GATE)
        return np.asarray(known & (self.contradictions < self.contradictions_max))
