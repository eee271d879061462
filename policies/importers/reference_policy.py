"""A policy as the library that trained it runs it, and its graph: what every reader of a foreign file gives."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from onnx import ModelProto

from robots.arrays import Float32s
from robots.errors import ContractError

STILL = -1
"""Stands for a number of a policy's observation that we have not: it is 0."""
Play = Callable[[Float32s, NDArray[np.bool_]], Float32s]
"""Observations (T, N) one after the other, and before which of them (T,) all is forgotten: actions (T, A)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Memory:
    """What one step of a graph hands on to the next.

    Attributes:
        before, after: names of its input and its output.
        shape: of one robot's, its batch of one included.
    """

    before: str
    after: str
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """How many numbers."""
        return int(np.prod(self.shape))


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """What a file says without being asked.

    Attributes:
        kind: what it was recognized as, in words.
        observations, actions: N and A, numbers in an observation and in an action.
        known: fields of its contract, as `draft.Draft` names them.
    """

    kind: str
    observations: int
    actions: int
    known: Mapping[str, Any] = field(default_factory=dict)


class UnansweredError(ContractError):
    """Something that decides what a policy computes is not in its file.

    Attributes:
        facts: what is; in `known`, what is not is "?".
    """

    def __init__(self, message: str, facts: Facts) -> None:
        super().__init__(message)
        self.facts = facts


@dataclass(frozen=True, slots=True, kw_only=True)
class Original:
    """A foreign policy.

    Attributes:
        facts: what its file says.
        model: its graph, float32.
        observation, action: names of the input (batch, N) and the output (batch, A).
        memory: what it remembers; nothing: ().
        batched: whether the graph takes any batch; else just one robot.
        play: the original itself, one robot.
        mean, deviation: (N,) of the observations in training, where the file knows them.
    """

    facts: Facts
    model: ModelProto
    observation: str
    action: str
    memory: tuple[Memory, ...] = ()
    batched: bool
    play: Play
    mean: tuple[float, ...] | None = None
    deviation: tuple[float, ...] | None = None

    @property
    def memory_size(self) -> int:
        """M, numbers that it remembers."""
        return sum(memory.size for memory in self.memory)

    def exchanged(self, theirs: Float32s, columns: NDArray[np.int64]) -> Float32s:
        """Observations (..., N) in our order, (..., M); where `columns` (N,) says STILL, 0 is put into theirs.

        Args:
            theirs: changed in place. columns: as `settle.Settled` has them.
        """
        moves = columns != STILL
        theirs[..., ~moves] = 0.0
        ours = np.empty((*theirs.shape[:-1], np.count_nonzero(moves)), np.float32)
        ours[..., columns[moves]] = theirs[..., moves]
        return ours

    def scattered(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Float32s:
        """(*shape, N) observations, as far apart as those in training where the file knows them, else by 1."""
        noise = rng.normal(size=(*shape, self.facts.observations)) * (self.deviation or 1.0)
        return (noise + (self.mean or 0.0)).astype(np.float32)
