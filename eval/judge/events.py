"""From bad ticks to events: consecutive ones of a channel are one event, unless a gap lies between them."""

from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.stage import Stage
from eval.judge.counts import MONITORS, monitor_of
from robots.arrays import Floats, Ints

EVENTS_KEPT = 500
"""Events of each monitor that a judge keeps one by one, the first ones; all are counted."""


class Bad(NamedTuple):
    """Bad ticks: four arrays as long as there are. `channel` is of `Counts`, `robot` its row."""

    tick: Ints
    robot: Ints
    channel: Ints
    load: Floats


def _some(bad: Bad, which: NDArray[Any]) -> Bad:
    """Those at places, or where flags hold."""
    return Bad(bad.tick[which], bad.robot[which], bad.channel[which], bad.load[which])


class Events(Stage):
    """Events of R robots with C channels.

    Attributes:
        bad_ticks, events: (R, C) counted. last_bad: (R, C) the newest bad tick.
        slot: (R, C) where the channel's newest event is kept, -1 where it is not.
        kept: (monitors,) how many are. robot, channel, start, last, worst: (monitors × EVENTS_KEPT,) what is: ticks of
            the first and the last bad one, and the highest load.
    """

    OF_EACH: ClassVar[tuple[str, ...]] = ("robot", "channel", "start", "last", "worst")
    carried: ClassVar[tuple[str, ...]] = ("bad_ticks", "events", "last_bad", "slot", "kept", *OF_EACH)

    def __init__(self, robots: int, joints: int, channels: int, gap: int) -> None:
        """Nothing happened yet; `gap` is in ticks."""
        self._gap, self._monitor = gap, monitor_of(joints)
        self.bad_ticks, self.events = np.zeros((2, robots, channels), dtype=np.int64)
        self.last_bad = np.full((robots, channels), -gap - 1)
        self.slot = np.full((robots, channels), -1)
        self.kept, room = np.zeros(len(MONITORS), dtype=np.int64), len(MONITORS) * EVENTS_KEPT
        self.robot, self.channel, self.start, self.last = np.full((4, room), -1)
        self.worst = np.zeros(room)

    def record(self, bad: Bad) -> None:
        """Count bad ticks that came after all those before; which of them come first does not matter."""
        place = bad.robot * self.slot.shape[1] + bad.channel
        order = np.lexsort((bad.tick, place))  # one channel after the other, each in the order of time
        bad, place = _some(bad, order), place[order]
        here, first, many = np.unique(place, return_index=True, return_counts=True)
        end = first + many - 1
        before = np.roll(bad.tick, 1)
        before[first] = self.last_bad.reshape(-1)[here]
        begins = bad.tick - before > self._gap
        slot = self._slots(bad, place, begins, first)
        self.last_bad.reshape(-1)[here] = bad.tick[end]
        self.slot.reshape(-1)[here] = slot[end]
        self.bad_ticks.reshape(-1)[here] += many
        self.events.reshape(-1)[here] += np.add.reduceat(begins.astype(np.int64), first)
        known = slot >= 0
        np.maximum.at(self.last, slot[known], bad.tick[known])
        np.maximum.at(self.worst, slot[known], bad.load[known])

    def _slots(self, bad: Bad, place: Ints, begins: NDArray[np.bool_], first: Ints) -> Ints:
        """Where the event of each bad tick is kept, -1 where there is no room for it."""
        slot = self.slot.reshape(-1)[place]
        slot[begins] = self._begin(_some(bad, begins))
        says = begins.copy()
        says[first] = True
        return slot[np.maximum.accumulate(np.where(says, np.arange(len(slot)), 0))]

    def _begin(self, bad: Bad) -> Ints:
        """Give events that begin their places, the earlier one first, whatever ticks are looked at together."""
        monitor = self._monitor[bad.channel]
        order = np.lexsort((bad.channel, bad.robot, bad.tick, monitor))
        here, first, many = np.unique(monitor[order], return_index=True, return_counts=True)
        number = np.arange(len(order)) - np.repeat(first - self.kept[here], many)
        kept = number < EVENTS_KEPT
        slot = np.full(len(order), -1)
        slot[order] = np.where(kept, monitor[order] * EVENTS_KEPT + number, -1)
        self.kept[here] = np.minimum(self.kept[here] + many, EVENTS_KEPT)
        room = slot >= 0
        for name in ("robot", "channel"):
            getattr(self, name)[slot[room]] = getattr(bad, name)[room]
        self.start[slot[room]] = bad.tick[room]
        return slot
