"""What paces the ticks: the wall's time on an absolute grid, or none."""

import time
from collections.abc import Callable
from typing import Protocol


class Clock(Protocol):
    """Paces ticks and counts the slots that were missed."""

    skipped: int

    def wait(self) -> float:
        """Block until the next slot of the grid; return how late it was met, in s."""
        ...


class Unpaced:
    """As fast as possible: never waits, is never late."""

    skipped = 0

    def wait(self) -> float:
        """Return at once."""
        return 0.0


class WallClock:
    """Slots at t0 + k · period. A slot that passed unused is skipped and counted, never made up for."""

    def __init__(
        self,
        period: float,
        *,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Start the grid at the first `wait`.

        Args:
            period: s.
            now: s, a monotonic clock.
            sleep: blocks for s.
        """
        self.period, self.skipped = period, 0
        self._now, self._sleep = now, sleep
        self._next: float | None = None

    def wait(self) -> float:
        """Block until the next slot; return how late it was met, in s."""
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
