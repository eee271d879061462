"""Event log: consecutive bad ticks of a channel are one event, unless a gap lies between them."""

from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.stage import Stage
from eval.judge.channels import Channels
from robots.arrays import Bools, Floats, Ints

EVENTS_KEPT = 500
"""Events of each monitor that are logged one by one, the first ones; all are counted."""


class BadTicks(NamedTuple):
    """Bad ticks: four arrays of equal length. `robot` and `channel` are row and column of `Counts`."""

    tick: Ints
    robot: Ints
    channel: Ints
    ratio: Floats

    def at(self, index: NDArray[Any]) -> "BadTicks":
        """Return those at an index or mask."""
        return BadTicks(*(column[index] for column in self))


class EventLog(Stage):
    """Events of R robots with C channels.

    Attributes:
        bad_ticks, events: (R, C) counts. last_bad: (R, C) the newest bad tick.
        row: (R, C) row of the log with the channel's newest event, -1 if it was not logged.
        logged: (monitors,) number of events in the log.
        robot, channel, start, last, worst: (monitors × EVENTS_KEPT,) the log: first and last bad tick, highest ratio.
            A row whose `start` is -1 is empty.
    """

    LOG: ClassVar[tuple[str, ...]] = ("robot", "channel", "start", "last", "worst")
    carried: ClassVar[tuple[str, ...]] = ("bad_ticks", "events", "last_bad", "row", "logged", *LOG)

    def __init__(self, channels: Channels, robots: int, gap: int) -> None:
        """Allocate for R robots; bad ticks further apart than `gap` ticks are two events."""
        self._gap, self._monitor = gap, channels.monitor_index
        shape, monitors = (robots, len(self._monitor)), len(channels.catalogue)
        self.bad_ticks, self.events = np.zeros((2, *shape), dtype=np.int64)
        self.last_bad, self.row = np.full(shape, -gap - 1), np.full(shape, -1)
        self.logged, size = np.zeros(monitors, dtype=np.int64), monitors * EVENTS_KEPT
        self.robot, self.channel, self.start, self.last = np.full((4, size), -1)
        self.worst = np.zeros(size)

    def record(self, bad: BadTicks) -> None:
        """Count bad ticks, in any order, that are later than all recorded before."""
        place = bad.robot * self.row.shape[1] + bad.channel
        order = np.lexsort((bad.tick, place))  # channel by channel, each in the order of time
        bad, place = bad.at(order), place[order]
        here, first, count = np.unique(place, return_index=True, return_counts=True)
        end = first + count - 1
        before = np.roll(bad.tick, 1)
        before[first] = self.last_bad.reshape(-1)[here]
        begins = bad.tick - before > self._gap
        row = self._rows(bad, place, begins, first)
        self.last_bad.reshape(-1)[here] = bad.tick[end]
        self.row.reshape(-1)[here] = row[end]
        self.bad_ticks.reshape(-1)[here] += count
        self.events.reshape(-1)[here] += np.add.reduceat(begins.astype(np.int64), first)
        logged = row >= 0
        np.maximum.at(self.last, row[logged], bad.tick[logged])
        np.maximum.at(self.worst, row[logged], bad.ratio[logged])

    def _rows(self, bad: BadTicks, place: Ints, begins: Bools, first: Ints) -> Ints:
        """Row of the log of each bad tick's event, -1 if it is not logged."""
        row = self.row.reshape(-1)[place]
        row[begins] = self._append(bad.at(begins))
        sets_row = begins.copy()
        sets_row[first] = True
        return row[np.maximum.accumulate(np.where(sets_row, np.arange(len(row)), 0))]

    def _append(self, bad: BadTicks) -> Ints:
        """Log events by their first ticks, earlier ones first, so that rows do not depend on the block size."""
        monitor = self._monitor[bad.channel]
        order = np.lexsort((bad.channel, bad.robot, bad.tick, monitor))
        here, first, count = np.unique(monitor[order], return_index=True, return_counts=True)
        number = np.arange(len(order)) - np.repeat(first - self.logged[here], count)
        row = np.full(len(order), -1)
        row[order] = np.where(number < EVENTS_KEPT, monitor[order] * EVENTS_KEPT + number, -1)
        self.logged[here] = np.minimum(self.logged[here] + count, EVENTS_KEPT)
        logged = row >= 0
        for name in ("robot", "channel"):
            getattr(self, name)[row[logged]] = getattr(bad, name)[logged]
        self.start[row[logged]] = bad.tick[logged]
        return row
