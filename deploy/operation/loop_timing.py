"""How well the ticks keep to their grid."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from deploy.operation.clock import Clock

OVERRUN_SHARE = 0.1
"""Share of the slots of the last second that may be skipped before the robot is stopped."""
BINS = 20_000
"""Lateness is counted in bins of 1 µs; what is later than all of them counts in the last."""
WINDOW_S = 1.0

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Lateness:
    """How late slots were met, µs."""

    p50_us: float
    p99_us: float
    max_us: float


class Every(Generic[T]):
    """Calls something at most once in a while of wall time."""

    def __init__(
        self, period: float, call: Callable[[T], None], *, now: Callable[[], float] = time.monotonic
    ) -> None:
        """The first call goes through.

        Args:
            period: s.
            call: what is called.
            now: s, a monotonic clock.
        """
        self._period, self._call, self._now, self._next = period, call, now, -np.inf

    def __call__(self, what: T) -> None:
        """Pass it on if it is time."""
        if (now := self._now()) >= self._next:
            self._next = now + self._period
            self._call(what)


class Pace:
    """A clock that is watched: rate, lateness, skipped slots. Its memory does not grow with time."""

    def __init__(self, clock: Clock, hz: int, *, now: Callable[[], float] = time.monotonic) -> None:
        """Nothing is counted before the first `wait`.

        Args:
            clock: what paces.
            hz: slots in a second of robot time.
            now: s, a monotonic clock.
        """
        self.ticks, self.late_max = 0, 0.0
        self._clock, self._hz, self._now = clock, hz, now
        self._budget = round(OVERRUN_SHARE * hz)
        self._late = np.zeros(BINS, dtype=np.int64)
        self._missed: deque[tuple[int, int]] = deque()
        self._marks: deque[tuple[float, int]] = deque()
        self._begun = 0.0

    @property
    def skipped(self) -> int:
        """Slots that passed unused."""
        return self._clock.skipped

    @property
    def overrun(self) -> bool:
        """Whether too many slots of the last second were skipped."""
        return sum(missed for _, missed in self._missed) > self._budget

    def wait(self) -> None:
        """Block until the next slot."""
        before = self._clock.skipped
        late = self._clock.wait()
        if self.ticks == 0:
            self._begun = self._now()
        self.ticks += 1
        self.late_max = max(self.late_max, late)
        self._late[min(max(int(late * 1e6), 0), BINS - 1)] += 1
        slot = self.ticks + self._clock.skipped
        if missed := self._clock.skipped - before:
            self._missed.append((slot, missed))
        while self._missed and self._missed[0][0] <= slot - self._hz:
            self._missed.popleft()

    @property
    def lateness(self) -> Lateness:
        """Over the whole run."""
        p50, p99 = np.searchsorted(np.cumsum(self._late), np.array([0.5, 0.99]) * self.ticks)
        return Lateness(p50_us=float(p50), p99_us=float(p99), max_us=self.late_max * 1e6)

    @property
    def elapsed(self) -> float:
        """Wall time since the first tick, s."""
        return self._now() - self._begun if self.ticks else 0.0

    @property
    def rate(self) -> float:
        """Hz, over the whole run."""
        return (self.ticks - 1) / elapsed if (elapsed := self.elapsed) > 0 else 0.0

    def recent_rate(self) -> float:
        """Hz, over about the last second before this call."""
        now = self._now()
        while len(self._marks) > 1 and self._marks[0][0] < now - WINDOW_S:
            self._marks.popleft()
        self._marks.append((now, self.ticks))
        then, ticks = self._marks[0]
        return (self.ticks - ticks) / (now - then) if now > then else 0.0
