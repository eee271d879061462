"""Detection of an observation normalizer in a graph, independent of its operators.

The input of the first weights is evaluated for an observation of zeros and for small steps of each number. If it is
linear per number, slope and value give the divisor and the mean. Works for Sub and Div, Mul and Add,
BatchNormalization, with or without reordering.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from onnx import GraphProto, ModelProto, helper

from deploy.policy.contract import Observed
from deploy.policy.inference import BATCHES, load_session
from deploy.policy.onnx_graph import decode, shortened
from deploy.policy.policy_file import PolicyFile
from deploy.policy.policy_names import INPUT
from robots.arrays import Float32s, Floats
from robots.errors import ContractError

MIXING_OPERATORS = ("Gemm", "MatMul", "LSTM", "GRU", "RNN", "Conv", "Scan")
"""Operators that mix the numbers of an observation."""
STEP = 1e-2
"""Step of each number, too small to reach a clip."""
IDENTITY_TOLERANCE = 1e-4
"""Tolerance for a normalizer that changes nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistics:
    """Mean and deviation (N,) of observations in the contract's order and scale."""

    mean: Floats
    deviation: Floats

    @classmethod
    def of(cls, observed: Observed) -> Self:
        """Return the statistics in a contract."""
        return cls(mean=np.array(observed.mean), deviation=np.array(observed.deviation))


def normalizer_of(file: PolicyFile) -> Statistics | None:
    """Return the normalizer before the first weights; None if there is none."""
    model = decode(file.data, "policy")
    if (name := _first_weighted_tensor(model.graph)) in (None, INPUT):
        return None
    zero, stepped = _values_of(model, str(name), file)
    slopes, size = (stepped - zero) / STEP, file.contract.observation_size
    nonzero = np.abs(slopes) > 1e-9
    if zero.shape != (size,) or any((nonzero.sum(axis=axis) != 1).any() for axis in (0, 1)):
        return None  # not one linear function per number
    index = nonzero.argmax(axis=1)
    slope = slopes[np.arange(size), index].astype(float)
    mean = -zero[index] / slope
    if np.abs(slope - 1.0).max() < IDENTITY_TOLERANCE and np.abs(mean).max() < IDENTITY_TOLERANCE:
        return None
    return Statistics(mean=mean, deviation=1.0 / np.abs(slope))


def _first_weighted_tensor(graph: GraphProto) -> str | None:
    """Return the tensor from the observation that enters the first operator mixing its numbers."""
    from_observation = {INPUT}
    for node in graph.node:
        found = [name for name in node.input if name in from_observation]
        if found and node.op_type in MIXING_OPERATORS:
            return found[-1]
        if found:
            from_observation.update(node.output)
    return None


def _values_of(model: ModelProto, name: str, file: PolicyFile) -> tuple[Float32s, Float32s]:
    """Return tensor `name` for an observation of zeros, (M,), and for a step of each number, (N, M).

    Raises:
        ContractError: it cannot be computed.
    """
    cut = ModelProto()
    cut.CopyFrom(model)
    del cut.graph.output[:]
    cut.graph.output.append(helper.make_empty_tensor_value_info(name))
    run = load_session(cut.SerializeToString(), "policy")
    size, batch = file.contract.observation_size, BATCHES[-1]
    rows = np.zeros((-(-(1 + size) // batch) * batch, size), np.float32)
    rows[1 : 1 + size] = STEP * np.eye(size)
    memory = np.zeros((batch, file.contract.memory), np.float32)
    feeds = {value.name: memory for value in run.get_inputs()}
    try:
        parts = [run.run([name], feeds | {INPUT: part})[0] for part in rows.reshape(-1, batch, size)]
        found = np.concatenate([part.reshape(batch, -1) for part in parts])
    except Exception as e:  # ONNX Runtime's errors share no base
        raise ContractError(f"tensor {name!r:.100}: cannot be computed: {shortened(e)}") from e
    return found[0], found[1 : 1 + size]
