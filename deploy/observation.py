"""The only place where an observation is assembled, from the contract's terms."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from deploy.contract import Contract, Term
from deploy.stage import Stage
from deploy.state import Bools, Floats

Sources = Mapping[str, Callable[[], Floats]]
"""For each source a contract may name: a reading (B, size), SI units."""


class Observation(Stage):
    """The policy's input (B, N) float32; each term's history oldest first, filled by its first frame."""

    carried = ("frames", "started")

    def __init__(self, contract: Contract, sources: Sources, robots: int) -> None:
        """Allocate.

        Args:
            contract: names the terms; checked against the robot beforehand.
            sources: where they come from.
            robots: B.
        """
        self.frames = np.zeros((robots, contract.observation_size), dtype=np.float32)
        self.started = np.zeros(robots, dtype=bool)
        self._parts, start = [], 0
        for term in contract.observation:
            stop = start + term.size * term.history
            self._parts.append((term, slice(start, stop), np.array(term.scale), sources[term.source]))
            start = stop

    def reset(self, ids: Bools) -> None:
        """Forget the history of robots where `ids` (B,) holds."""
        self.started[ids] = False

    def step(self) -> NDArray[np.float32]:
        """Assemble one observation for each robot."""
        for term, part, scale, source in self._parts:
            _push(self.frames[:, part], _scaled(term, scale, source()), ~self.started)
        self.started[:] = True
        return self.frames


def _scaled(term: Term, scale: Floats, reading: Floats) -> Floats:
    value = reading / scale
    return value if term.clip is None else np.clip(value, *term.clip)


def _push(frames: NDArray[np.float32], newest: Floats, first: Bools) -> None:
    """Move a term's history on by one frame, in place; where `first` holds, every frame is the newest."""
    size = newest.shape[1]
    frames[:, :-size] = frames[:, size:]
    frames[:, -size:] = newest
    if first.any() and frames.shape[1] > size:
        frames[first] = np.tile(newest[first], frames.shape[1] // size)
