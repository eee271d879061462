"""Overrun: too many slots of the last second were skipped, because ticks were late."""

from typing import ClassVar

import numpy as np

from deploy.masks import any_true
from deploy.stage import Stage
from robots.arrays import Bools, Ints

OVERRUN_SHARE = 0.1
"""Share of the slots of the last second that may be skipped before the robot is stopped."""


class Overrun(Stage):
    """Skipped slots of B loops, of which each tick uses one slot.

    Attributes:
        slot: (B,) slots so far. place: (1,) of the newest tick in the next two.
        missed: (B, hz) slots skipped before each of the last hz ticks. at: (B, hz) the slots of these ticks.
    """

    carried: ClassVar[tuple[str, ...]] = ("slot", "place", "missed", "at")

    def __init__(self, robots: int, hz: int) -> None:
        """Allocate; `hz` slots are one second of robot time."""
        self._hz, self._skipped_max = hz, round(OVERRUN_SHARE * hz)
        self.slot, self.place = np.zeros(robots, dtype=np.int64), np.zeros(1, dtype=np.int64)
        self.missed, self.at = np.zeros((2, robots, hz), dtype=np.int32)

    def step(self, missed: Ints) -> None:
        """Count a tick of each loop, and the slots (B,) that were skipped before it."""
        self.slot += 1 + missed
        self.place[:] = place = (self.place + 1) % self._hz
        self.missed[:, place[0]], self.at[:, place[0]] = missed, self.slot

    @property
    def overrun(self) -> Bools:
        """(B,) loops that skipped more than `OVERRUN_SHARE` of the slots of the last second."""
        if not any_true(self.missed):
            return np.zeros(len(self.slot), dtype=bool)
        recent = self.at > (self.slot - self._hz)[:, None]
        return np.asarray((self.missed * recent).sum(axis=1) > self._skipped_max)
