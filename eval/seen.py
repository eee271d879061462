"""What the judge was shown: written down tick by tick, to be judged some ticks at a time."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.state import Bools, Floats, Ints

TOGETHER = 32
"""Ticks judged at once, which share what a call of numpy costs: results do not depend on it."""


@dataclass(frozen=True, slots=True)
class Seen:
    """Arrays (T, B, ...) of what `Judge.step` is told, by its names; `target` and `sent` are angles."""

    target: Floats
    q: Floats
    qd: Floats
    tau: Floats
    winding_c: Floats
    sent: Floats
    tool_position: Floats
    tool_velocity: Floats
    goal: Floats
    powered: Bools
    self_collision: Bools
    valid: Bools
    mode: Ints
    reason: Ints
    attempted: Ints

    @classmethod
    def room(cls, robots: int, n: int) -> "Seen":
        """Allocate for `TOGETHER` ticks."""
        shape = (TOGETHER, robots)
        flags, whole = np.zeros((3, *shape), dtype=bool), np.zeros((3, *shape), dtype=np.int64)
        return cls(*np.zeros((6, *shape, n)), *np.zeros((3, *shape, 3)), *flags, *whole)

    def arrays(self) -> tuple[NDArray[np.generic], ...]:
        """All of them, in order."""
        return tuple(getattr(self, field.name) for field in fields(self))

    def first(self, ticks: int) -> "Seen":
        """Only the first ticks."""
        rows: Any = (array[:ticks] for array in self.arrays())
        return Seen(*rows)
