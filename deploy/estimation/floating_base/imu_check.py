"""Plausibility of IMU readings: range, and samples that repeat themselves."""

import numpy as np

from deploy.estimation.sample_count import sample_count
from deploy.stage import Stage
from robots.arrays import Bools, Floats

RANGE = 1e4
"""rad/s, m/s² or m: a reading beyond it is invalid."""
STUCK_S = 0.05
"""s of equal samples in a row, which no noise explains."""


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
