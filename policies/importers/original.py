"""A policy as the library that trained it runs it, and its graph: what every reader of a foreign file gives."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from onnx import ModelProto

from deploy.policy_file import Float32s

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
class Original:
    """A foreign policy.

    Attributes:
        kind: what it was recognized as, in words.
        model: its graph, float32.
        observation, action: names of the input (batch, N) and the output (batch, A).
        observations, actions: N and A.
        memory: what it remembers; nothing: ().
        batched: whether the graph takes any batch; else just one robot.
        play: the original itself, one robot.
        mean, deviation: (N,) of the observations in training, where the file knows them.
        known: what the file says of its contract, by fields of `draft.Draft`.
    """

    kind: str
    model: ModelProto
    observation: str
    action: str
    observations: int
    actions: int
    memory: tuple[Memory, ...] = ()
    batched: bool
    play: Play
    mean: tuple[float, ...] | None = None
    deviation: tuple[float, ...] | None = None
    known: Mapping[str, object] = field(default_factory=dict)

    @property
    def memory_size(self) -> int:
        """M, numbers that it remembers."""
        return sum(memory.size for memory in self.memory)
