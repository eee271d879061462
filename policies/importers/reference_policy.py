"""The reference policy: its ONNX graph, and a function that runs it with the library that trained it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from onnx import ModelProto

from robots.arrays import Float32s
from robots.errors import ContractError

ABSENT = -1
"""Marks a number of a policy's observation that the robot does not measure; it is set to 0."""
RunSequence = Callable[[Float32s, NDArray[np.bool_]], Float32s]
"""Function from observations (T, N) in time order, and resets (T,) before steps, to actions (T, A)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Memory:
    """Recurrent state of a graph.

    Attributes:
        input_name, output_name: of the graph.
        shape: for one robot, including the batch dimension of 1.
    """

    input_name: str
    output_name: str
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """Number of elements."""
        return int(np.prod(self.shape))


@dataclass(frozen=True, slots=True, kw_only=True)
class PolicyFacts:
    """Properties read from the policy's file.

    Attributes:
        kind: recognized format, in words.
        observations, actions: sizes N and A.
        known: known fields of its contract, named as in `contract_draft.ContractDraft`.
    """

    kind: str
    observations: int
    actions: int
    known: Mapping[str, Any] = field(default_factory=dict)


class MissingSettingError(ContractError):
    """A setting that decides what the policy computes is missing in its file.

    Attributes:
        facts: the known properties; missing ones are "?" in `known`.
    """

    def __init__(self, message: str, facts: PolicyFacts) -> None:
        super().__init__(message)
        self.facts = facts


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferencePolicy:
    """A policy of another library.

    Attributes:
        facts: properties read from its file.
        model: its graph, float32.
        observation, action: names of the input (batch, N) and the output (batch, A).
        memory: recurrent states; () for a feed-forward policy.
        batched: True if the graph takes any batch, False if only one robot.
        run: the original policy, for one robot.
        mean, deviation: (N,) statistics of the observations in training; None if unknown.
        files: other files that were read: external weights, a normalizer.
    """

    facts: PolicyFacts
    model: ModelProto
    observation: str
    action: str
    memory: tuple[Memory, ...] = ()
    batched: bool
    run: RunSequence
    mean: tuple[float, ...] | None = None
    deviation: tuple[float, ...] | None = None
    files: tuple[Path, ...] = ()

    @property
    def memory_size(self) -> int:
        """M, number of recurrent state elements."""
        return sum(memory.size for memory in self.memory)

    def reorder_observations(self, inputs: Float32s, columns: NDArray[np.int64]) -> Float32s:
        """Return observations (..., N) in the contract's order, (..., M), and set absent numbers of `inputs` to 0.

        Args:
            inputs: (..., N) in the policy's order, changed in place.
            columns: (N,) as in `contract_builder.BuiltContract`.
        """
        present = columns != ABSENT
        inputs[..., ~present] = 0.0
        reordered = np.empty((*inputs.shape[:-1], np.count_nonzero(present)), np.float32)
        reordered[..., columns[present]] = inputs[..., present]
        return reordered

    def sample_observations(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Float32s:
        """Draw observations (*shape, N) with the mean and deviation of training, or 0 and 1 if unknown."""
        noise = rng.normal(size=(*shape, self.facts.observations)) * (self.deviation or 1.0)
        return (noise + (self.mean or 0.0)).astype(np.float32)
