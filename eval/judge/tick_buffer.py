"""Ring buffer of judge inputs, evaluated 200 ticks at a time."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.stage import Arrays, Stage
from robots.arrays import Bools, Floats, Ints

BLOCK_TICKS = 200
"""Ticks evaluated at once, to share the cost of numpy calls. Results do not depend on it."""
PAST = 3
"""Ticks kept from before the block: as many as a third difference needs."""


class Ticks(NamedTuple):
    """Arrays (PAST + T, B, ...) of the arguments of `Judge.step`. The first `PAST` ticks were judged before.

    `target` and `sent` are angles, `tau_sent` feed-forward torques of the command. `q_hat`, `q_var` and `age` are the
    estimate before the physics of that tick. `action_finite` is True where the policy was not called.
    `achieved` is what `goal` is compared with, by ground truth. `tilt`: rad, of a floating base.
    """

    target: Floats
    q: Floats
    qd: Floats
    tau: Floats
    winding_c: Floats
    sent: Floats
    tau_sent: Floats
    q_hat: Floats
    q_var: Floats
    tool_position: Floats
    tool_velocity: Floats
    achieved: Floats
    goal: Floats
    age: Floats
    contact_n: Floats
    tilt: Floats
    powered: Bools
    action_finite: Bools
    self_collision: Bools
    valid: Bools
    mode: Ints
    reason: Ints
    attempted: Ints
    observation: NDArray[np.float32]

    def at(self, index: Any) -> "Ticks":
        """Return views of all arrays at an index."""
        arrays: Any = (array[index] for array in self)
        return Ticks(*arrays)


class TickBuffer(Stage):
    """Ticks that were not judged yet, and the `PAST` ticks before them.

    Before the first tick robots are disarmed, and all else is 0.

    Attributes:
        pending: number of ticks appended and not yet judged.
    """

    def __init__(self, robots: int, n: int, observation: int, goal: int) -> None:
        """Allocate for B robots of n joints, observations and goals of so many numbers."""
        shape = (PAST + BLOCK_TICKS, robots)
        flags, integers = np.zeros((4, *shape), dtype=bool), np.zeros((3, *shape), dtype=np.int64)
        arrays: tuple[Any, ...] = (
            *np.zeros((9, *shape, n)),
            *np.zeros((2, *shape, 3)),
            *np.zeros((2, *shape, goal)),
            *np.zeros((3, *shape)),
            *flags,
            *integers,
            np.zeros((*shape, observation), dtype=np.float32),
        )
        self._ticks, self.pending = Ticks(*arrays), 0

    def append(self, tick: tuple[NDArray[Any], ...]) -> None:
        """Append one tick (B, ...), in the order of `Ticks`."""
        row = PAST + self.pending
        arrays: tuple[NDArray[Any], ...] = self._ticks
        for array, value in zip(arrays, tick, strict=True):
            array[row] = value
        self.pending += 1

    def pending_ticks(self, robots: int) -> Ticks:
        """Return views of the pending ticks of the first robots, and of the `PAST` ticks before."""
        return self._ticks.at((slice(PAST + self.pending), slice(robots)))

    def clear(self) -> None:
        """Drop all but the last `PAST` ticks."""
        for array in self._ticks:
            array[:PAST] = array[self.pending : self.pending + PAST]
        self.pending = 0

    def save(self) -> Arrays:
        """Return copies of the past (B, PAST, ...); pending ticks must have been judged before."""
        return {name: array.copy() for name, array in self._past().items()}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Restore a saved past, bit for bit, and drop pending ticks."""
        for name, array in self._past().items():
            array[...] = arrays[name]
        self.pending = 0

    def _past(self) -> dict[str, NDArray[Any]]:
        return {name: array[:PAST].swapaxes(0, 1) for name, array in self._ticks._asdict().items()}
