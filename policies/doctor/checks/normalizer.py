"""Whether a graph brings observations to a mean of 0 and a deviation of 1 before its first weights.

However it is written (Sub and Div, Mul and Add, BatchNormalization, behind a reordering or not): what reaches the first
weights is asked for, of an observation of zeros and of one with a little in each place, and the line through both says
what was subtracted and divided by.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from onnx import GraphProto, ModelProto, helper

from deploy.policy.contract import Observed
from deploy.policy.onnx_graph import decode
from deploy.policy.policy import load_session
from deploy.policy.policy_file import INPUT, PolicyFile
from robots.arrays import Floats

WEIGHS = ("Gemm", "MatMul", "LSTM", "GRU", "RNN", "Conv", "Scan")
"""Operators that mix the numbers of an observation."""
LITTLE = 1e-2
"""In each place: too little to meet a clip."""
SAME = 1e-4
"""By so little a normalizer that changes nothing differs from none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistics:
    """Of an observation (N,), in the contract's order and scale."""

    mean: Floats
    deviation: Floats

    @classmethod
    def of(cls, observed: Observed) -> Self:
        """Those that a contract carries."""
        return cls(mean=np.array(observed.mean), deviation=np.array(observed.deviation))


def normalizer_of(file: PolicyFile) -> Statistics | None:
    """What stands before the first weights; None where nothing is there, or nothing that does this."""
    model = decode(file.data, "policy")
    if (name := _weighed(model.graph)) in (None, INPUT):
        return None
    zero, little = _reaching(model, str(name), file)
    slopes = (little - zero) / LITTLE
    size = file.contract.observation_size
    hit = np.abs(slopes) > 1e-9
    if zero.shape != (size,) or not (hit.sum(axis=0) == 1).all() or not (hit.sum(axis=1) == 1).all():
        return None  # something else than one line for each number
    place = hit.argmax(axis=1)
    slope = slopes[np.arange(size), place].astype(float)
    mean = -zero[place] / slope
    if np.abs(slope - 1.0).max() < SAME and np.abs(mean).max() < SAME:
        return None
    return Statistics(mean=mean, deviation=1.0 / np.abs(slope))


def _weighed(graph: GraphProto) -> str | None:
    """The tensor that comes from the observation to the first operator that mixes its numbers."""
    from_observation = {INPUT}
    for node in graph.node:
        found = [name for name in node.input if name in from_observation]
        if found and node.op_type in WEIGHS:
            return found[-1]
        if found:
            from_observation.update(node.output)
    return None


def _reaching(
    model: ModelProto, name: str, file: PolicyFile
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What `name` is for an observation of zeros, (M,), and for a little in each place, (N, M)."""
    cut = ModelProto()
    cut.CopyFrom(model)
    del cut.graph.output[:]
    cut.graph.output.append(helper.make_empty_tensor_value_info(name))
    run = load_session(cut.SerializeToString(), "policy")
    size = file.contract.observation_size
    rows = np.concatenate((np.zeros((1, size)), LITTLE * np.eye(size))).astype(np.float32)
    feeds = {
        value.name: np.zeros((len(rows), file.contract.memory), np.float32) for value in run.get_inputs()
    }
    found = run.run([name], feeds | {INPUT: rows})[0].reshape(len(rows), -1)
    return found[0], found[1:]
