"""What the judge was shown: written down tick by tick, to be judged some ticks at a time."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.stage import Arrays, Stage
from robots.arrays import Bools, Floats, Ints

TOGETHER = 200
"""Ticks judged at once, which share what a call of numpy costs: results do not depend on it."""
PAST = 3
"""Ticks remembered before those, as far as a third difference looks back."""


class Ticks(NamedTuple):
    """Arrays (PAST + T, B, ...) of what `Judge.step` is told, by its names; the first `PAST` were judged before.

    `target` and `sent` are angles and `tau_sent` torques of the command. What is not of the world is of the runtime:
    `q_hat`, `q_var` and `age` are its belief before the physics of that tick. `sound`: whether what the policy said in
    that tick, if anything, was numbers. `tool_velocity` of a robot with a base is the base's over the ground: m/s
    forwards and to the left, and rad/s to the left. `tilt`: rad, of a base.
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
    goal: Floats
    age: Floats
    contact_n: Floats
    tilt: Floats
    powered: Bools
    sound: Bools
    self_collision: Bools
    valid: Bools
    mode: Ints
    reason: Ints
    attempted: Ints
    observation: NDArray[np.float32]


class Seen(Stage):
    """The ticks that wait, and those just before them. Before the first tick robots are disarmed and nothing is known.

    Attributes:
        waiting: ticks that were put and not yet judged.
    """

    def __init__(self, robots: int, n: int, observation: int) -> None:
        """Allocate for B robots of n joints and observations of a size."""
        shape = (PAST + TOGETHER, robots)
        flags, whole = np.zeros((4, *shape), dtype=bool), np.zeros((3, *shape), dtype=np.int64)
        room: tuple[Any, ...] = (
            *np.zeros((9, *shape, n)),
            *np.zeros((3, *shape, 3)),
            *np.zeros((3, *shape)),
            *flags,
            *whole,
            np.zeros((*shape, observation), dtype=np.float32),
        )
        self._ticks, self.waiting = Ticks(*room), 0

    def put(self, now: tuple[NDArray[Any], ...]) -> None:
        """One tick (B, ...) more, in the order of `Ticks`."""
        at = PAST + self.waiting
        places: tuple[NDArray[Any], ...] = self._ticks
        for place, value in zip(places, now, strict=True):
            place[at] = value
        self.waiting += 1

    def first(self, robots: int) -> Ticks:
        """What waits and what was before, of the first robots."""
        rows: Any = (array[: PAST + self.waiting, :robots] for array in self._ticks)
        return Ticks(*rows)

    def turn(self) -> None:
        """What waited is past."""
        for array in self._ticks:
            array[:PAST] = array[self.waiting : self.waiting + PAST]
        self.waiting = 0

    def save(self) -> Arrays:
        """Copies of the past (B, PAST, ...); what waits is to be judged before."""
        return {name: array.copy() for name, array in self._past().items()}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put a saved past back, bit for bit; what waited is forgotten."""
        for name, array in self._past().items():
            array[...] = arrays[name]
        self.waiting = 0

    def _past(self) -> dict[str, NDArray[Any]]:
        return {name: array[:PAST].swapaxes(0, 1) for name, array in self._ticks._asdict().items()}
