"""Assembly of the policy's observation from the contract's terms: the only place where that is done."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from deploy.masks import all_true
from deploy.policy.contract import Contract
from deploy.policy.contract_term import Term
from deploy.stage import Stage
from robots.arrays import Bools, Float32s, Floats, Ints

Readers = Mapping[str, Callable[[], Floats]]
"""Readings (B, size) of observation sources, by name."""


class Observation(Stage):
    """Policy input (B, N) float32; the history of each term oldest first, filled as the contract says.

    Attributes:
        frames: (B, N) the newest observations. started: (B,) robots whose history has begun.
    """

    carried = ("frames", "started")

    def __init__(self, contract: Contract, readers: Readers, robots: int) -> None:
        """Allocate.

        Args:
            contract: names the terms; checked against the robot beforehand.
            readers: of every source that the contract names.
            robots: B.
        """
        terms = contract.observation
        self.frames = np.zeros((robots, contract.observation_size), dtype=np.float32)
        self.started = np.zeros(robots, dtype=bool)
        self._readers = [readers[term.source] for term in terms]
        offset = np.concatenate([term.offset or np.zeros(term.size) for term in terms])
        self._offset = np.tile(offset, (robots, 1)) if offset.any() else None
        self._scale = np.tile(np.concatenate([term.scale for term in terms]), (robots, 1))
        bounds = [term.clip or (-np.inf, np.inf) for term in terms for _ in range(term.size)]
        self._low, self._high = (np.tile(bound, (robots, 1)) for bound in zip(*bounds, strict=True))
        self._filled, self._pushed = _columns(terms)
        self._zeros = np.repeat([t.fill == "zeros" for t in terms], [t.size * t.history for t in terms])

    def reset(self, ids: Bools) -> None:
        """Forget the history of robots where `ids` (B,) holds."""
        self.started[ids] = False

    @np.errstate(invalid="ignore", over="ignore")  # the scale of a contract may be as small as it likes
    def step(self) -> Float32s:
        """Assemble one observation for each robot."""
        newest = np.concatenate([read() for read in self._readers], axis=1)
        if self._offset is not None:
            newest -= self._offset
        newest /= self._scale
        newest = np.minimum(np.maximum(newest, self._low), self._high)
        if not all_true(self.started):
            first = ~self.started
            self.frames[first] = np.where(self._zeros, 0.0, newest[first].take(self._filled, axis=1))
            self.started[:] = True
        both = np.concatenate((self.frames, newest), axis=1, dtype=np.float32)
        both.take(self._pushed, axis=1, out=self.frames)
        return self.frames


def _columns(terms: Sequence[Term]) -> tuple[Ints, Ints]:
    """Compute the gather indices that shift the history by one reading.

    Returns:
        For the first frame, columns of the newest readings. For any other frame, columns of the old frames followed by
        the newest readings: the newest frame of a term is its reading, every other one is the frame after it.
    """
    ends = np.cumsum([term.size for term in terms])
    reading = [np.arange(end - term.size, end) for term, end in zip(terms, ends, strict=True)]
    filled = np.concatenate([np.tile(r, term.history) for term, r in zip(terms, reading, strict=True)])
    size = np.concatenate([np.full(term.size * term.history, term.size) for term in terms])
    to_go = np.concatenate([np.arange(term.size * term.history)[::-1] for term in terms])
    columns = np.arange(len(filled))
    return filled, np.where(to_go < size, len(filled) + filled, columns + size)
