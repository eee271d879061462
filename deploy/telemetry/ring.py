"""Ring buffer of the recorded signals of the last ticks, at the full control rate."""

import numpy as np
from numpy.typing import NDArray

from deploy.runtime import Runtime
from deploy.telemetry.signals import COUNTERS, recorded_signals
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec

RING_S = 2.0

Rows = NDArray[np.void]


class Ring:
    """One preallocated array (T, B) of `row_type`, overwritten from the oldest tick on."""

    def __init__(
        self, spec: RobotSpec, robots: int, row: np.dtype[np.void], *, seconds: float = RING_S
    ) -> None:
        """Allocate for B robots, in rows of `row_type` or of a type that adds columns to it."""
        self.rows: Rows = np.zeros((round(seconds / spec.dt), robots), dtype=row)
        self._ticks, self._counters = 0, tuple(COUNTERS.values())
        self._readers = tuple(signal.read for signal in recorded_signals(spec))
        plain = (*self.rows.shape, -1)
        integers = self.rows.view(np.int64).reshape(plain).transpose(0, 2, 1)
        self._integers = integers[:, : len(COUNTERS)]
        self._numbers = self.rows.view(np.float64).reshape(plain)[:, :, len(COUNTERS) :]

    def step(self, runtime: Runtime, extra: tuple[Floats | Bools, ...] = ()) -> Rows:
        """Record the tick that has just ended; return its rows (B,). `extra`: added columns (B, ...)."""
        self._ticks = runtime.ticks
        at = (self._ticks - 1) % len(self.rows)
        for place, read in zip(self._integers[at], self._counters, strict=True):
            place[...] = read(runtime)
        # All at once: a field at a time takes twice as long.
        numbers = (*(read(runtime) for read in self._readers), *extra)
        np.concatenate(numbers, axis=1, out=self._numbers[at])
        rows: Rows = self.rows[at]
        return rows

    def last(self) -> Rows:
        """Return a copy (≤ T, B) in the order of time."""
        count = min(self._ticks, len(self.rows))
        return self.rows[np.arange(self._ticks - count, self._ticks) % len(self.rows)]
