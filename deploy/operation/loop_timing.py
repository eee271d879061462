"""Loop timing: clocks that set the rate of ticks, their lateness and skipped slots, and calls limited to a rate."""

import time
from collections import deque
from collections.abc import Callable
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from deploy.operation.overrun import Overrun

BINS = 20_000
"""Bins of the histogram of lateness, 1 µs each; the last one counts everything later."""
WINDOW_S = 1.0

T = TypeVar("T")


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


class Lateness(NamedTuple):
    """Percentiles of the lateness of ticks, µs."""

    p50_us: float
    p99_us: float
    max_us: float


class RateLimited(Generic[T]):
    """Call that goes through at most once per `period` s of wall time; the first one does."""

    def __init__(
        self, period: float, call: Callable[[T], None], *, now: Callable[[], float] = time.monotonic
    ) -> None:
        self._period, self._call, self._now, self._next = period, call, now, -np.inf

    def __call__(self, argument: T) -> None:
        """Pass the argument on, if it is time."""
        if (now := self._now()) >= self._next:
            self._next = now + self._period
            self._call(argument)


class LoopTiming:
    """Statistics of a clock: rate, lateness, skipped slots. Memory does not grow with time."""

    def __init__(self, clock: Clock, hz: int, *, now: Callable[[], float] = time.monotonic) -> None:
        """Count from the first `wait` on; `hz` slots of the clock are one second of robot time."""
        self.ticks, self.late_max = 0, 0.0
        self.clock, self._now, self._skipped = clock, now, Overrun(1, hz)
        self._histogram = np.zeros(BINS, dtype=np.int64)
        self._marks: deque[tuple[float, int]] = deque()
        self._begin = self._last = 0.0

    @property
    def overrun(self) -> bool:
        """True when too many slots of the last second were skipped."""
        return bool(self._skipped.overrun[0])

    def wait(self) -> int:
        """Block until the next slot; return the number of slots that were skipped before it."""
        before = self.clock.skipped
        late = self.clock.wait()
        self._last = self._now()
        if self.ticks == 0:
            self._begin = self._last
        self.ticks += 1
        self.late_max = max(self.late_max, late)
        self._histogram[min(max(int(late * 1e6), 0), BINS - 1)] += 1
        skipped = self.clock.skipped - before
        self._skipped.step(np.array([skipped]))
        return skipped

    @property
    def lateness(self) -> Lateness:
        """Lateness over the whole run."""
        p50, p99 = np.searchsorted(np.cumsum(self._histogram), np.array([0.5, 0.99]) * self.ticks)
        return Lateness(p50_us=float(p50), p99_us=float(p99), max_us=self.late_max * 1e6)

    @property
    def elapsed(self) -> float:
        """Wall time from the first tick to the last one, s: what follows the ticks is not counted."""
        return self._last - self._begin

    @property
    def rate(self) -> float:
        """Tick rate over the whole run, Hz."""
        return (self.ticks - 1) / elapsed if (elapsed := self.elapsed) > 0 else 0.0

    def recent_rate(self) -> float:
        """Tick rate over about the last second before this call, Hz."""
        now = self._now()
        while len(self._marks) > 1 and self._marks[0][0] < now - WINDOW_S:
            self._marks.popleft()
        self._marks.append((now, self.ticks))
        then, ticks = self._marks[0]
        return (self.ticks - ticks) / (now - then) if now > then else 0.0
