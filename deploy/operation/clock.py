"""Clocks that set the rate of ticks: wall time on an absolute grid, or none."""

import time
from collections.abc import Callable
from typing import Protocol


class Clock(Protocol):
    """Grid of slots, one for each tick; counts the slots that were missed.

    Attributes:
        skipped: slots that passed unused.
        hz: slots in a second of wall time; None: as fast as possible.
    """

    skipped: int
    hz: float | None

    def wait(self) -> float:
        """Block until the next slot; return the lateness, s."""
        ...


class Unpaced:
    """Clock without pacing: ticks run as fast as possible and are never late."""

    skipped = 0
    hz: float | None = None

    def wait(self) -> float:
        """Return at once."""
        return 0.0


class WallClock:
    """Slots at t0 + k · period (s), from the first `wait` on. A slot that passes unused is skipped and counted."""

    def __init__(
        self,
        period: float,
        *,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.period, self.skipped = period, 0
        self.hz: float | None = 1 / period
        self._now, self._sleep = now, sleep
        self._next: float | None = None

    def wait(self) -> float:
        """Block until the next slot; return the lateness, s."""
        if self._next is None:
            self._next = self._now()
        ahead = self._next - self._now()
        if ahead > 0:
            self._sleep(ahead)
        late = self._now() - self._next
        missed = max(0, int(late / self.period))
        self.skipped += missed
        self._next += (missed + 1) * self.period
        return late
