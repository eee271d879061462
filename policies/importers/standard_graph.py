"""ONNX graph with the standard inputs and outputs: (observation, memory) to (action, next_memory)."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import onnx
from onnx import GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto, helper, numpy_helper

from deploy.policy.policy_names import INPUT, MEMORY, NEXT, OUTPUT
from policies.export.onnx_file import strip_annotations
from policies.importers.reference_policy import ABSENT, ReferencePolicy

PREFIX = "policy/"
"""Prefix of every name of the imported graph, to avoid collisions."""
IR_MIN = 4
"""First IR version of ONNX in which weights need not be inputs."""


def to_standard_graph(
    reference: ReferencePolicy, columns: Sequence[int], joints: Sequence[int]
) -> ModelProto:
    """Return a model with the standard inputs and outputs, for a batch of any size.

    A graph for one robot, or one with memory, becomes the body of a Scan over robots: it runs for one robot after the
    other, so that robots cannot influence each other.

    Args:
        columns, joints: permutations as in `contract_builder.BuiltContract`.
    """
    plain = ModelProto()
    plain.CopyFrom(reference.model)
    strip_annotations(plain)
    inner, build = onnx.compose.add_prefix(plain, PREFIX).graph, _GraphBuilder()
    size = sum(column != ABSENT for column in columns)
    source = INPUT if size == len(columns) else build.append_zero(INPUT)
    observation = build.gather(source, [size if column == ABSENT else column for column in columns], axis=1)
    scanned = bool(reference.memory) or not reference.batched
    action = (_scan_over_robots if scanned else _inline_batched)(build, inner, reference, observation)
    build.identity(build.gather(action, joints, axis=1), OUTPUT)
    inputs, outputs = [_tensor_info(INPUT, size)], [_tensor_info(OUTPUT, reference.facts.actions)]
    if memory := reference.memory_size:
        inputs.append(_tensor_info(MEMORY, memory))
        outputs.append(_tensor_info(NEXT, memory))
    graph = helper.make_graph(build.nodes, "policy", inputs, outputs, build.weights)
    version = max(IR_MIN, reference.model.ir_version)
    return helper.make_model(graph, opset_imports=reference.model.opset_import, ir_version=version)


class _GraphBuilder:
    """Builder of nodes and weights."""

    def __init__(self) -> None:
        self.nodes: list[NodeProto] = []
        self.weights: list[TensorProto] = []

    def integers(self, values: Sequence[int]) -> str:
        name = f"integers_{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.array(values, dtype=np.int64), name))
        return name

    def add(self, kind: str, inputs: Sequence[str], output: str, axis: int | None = None) -> str:
        attributes: dict[str, Any] = {} if axis is None else {"axis": axis}
        self.nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    def identity(self, value: str, output: str) -> str:
        return self.add("Identity", [value], output)

    def gather(self, value: str, indices: Sequence[int], *, axis: int) -> str:
        if list(indices) == list(range(len(indices))):
            return value
        return self.add("Gather", [value, self.integers(indices)], f"{value}_ordered", axis=axis)

    def append_zero(self, value: str) -> str:
        """Append a column of zeros."""
        first = self.add("Gather", [value, self.integers([0])], f"{value}_first", axis=1)
        zero = self.add("Sub", [first, first], f"{value}_zero")
        return self.add("Concat", [value, zero], f"{value}_and_zero", axis=1)

    def reshape(self, value: str, shape: Sequence[int], output: str) -> str:
        return self.add("Reshape", [value, self.integers(shape)], output)


def _inline_batched(
    build: _GraphBuilder, inner: GraphProto, reference: ReferencePolicy, observation: str
) -> str:
    """Insert the graph itself: it takes all robots at once."""
    build.identity(observation, PREFIX + reference.observation)
    build.nodes.extend(inner.node)
    build.weights.extend(inner.initializer)
    return PREFIX + reference.action


def _scan_over_robots(
    build: _GraphBuilder, inner: GraphProto, reference: ReferencePolicy, observation: str
) -> str:
    """Insert the graph as the body of a Scan over robots."""
    facts, size, scanned_action = reference.facts, reference.memory_size, f"{OUTPUT}_theirs"
    body = _GraphBuilder()
    body.reshape("seen", [1, facts.observations], PREFIX + reference.observation)
    _split_memory(body, reference)
    body.nodes.extend(inner.node)
    body.weights.extend(inner.initializer)
    body.reshape(PREFIX + reference.action, [facts.actions], "done")
    inputs, outputs = [("seen", facts.observations)], [("done", facts.actions)]
    from_outside, to_outside = [observation], [scanned_action]
    flat = [
        body.reshape(PREFIX + m.output_name, [m.size], f"flat_{k}") for k, m in enumerate(reference.memory)
    ]
    if size:
        body.add("Concat", flat, "knows", axis=0)
        inputs.append(("known", size))
        outputs.append(("knows", size))
        from_outside.append(MEMORY)
        to_outside.append(NEXT)
    starts, ends = ([_tensor_info(*each, batch=False) for each in group] for group in (inputs, outputs))
    graph = helper.make_graph(body.nodes, "one_robot", starts, ends, body.weights)
    count = len(from_outside)
    scan = helper.make_node("Scan", from_outside, to_outside, body=graph, num_scan_inputs=count)
    build.nodes.append(scan)
    return scanned_action


def _split_memory(body: _GraphBuilder, reference: ReferencePolicy) -> None:
    """Reshape the parts of the flat memory of one robot to the graph's recurrent states."""
    ends = np.cumsum([0, *(memory.size for memory in reference.memory)])
    for (start, stop), memory in zip(pairwise(ends.tolist()), reference.memory, strict=True):
        part = body.add("Gather", ["known", body.integers(range(start, stop))], f"known_{start}", axis=0)
        body.reshape(part, memory.shape, PREFIX + memory.input_name)


def _tensor_info(name: str, size: int, *, batch: bool = True) -> ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size] if batch else [size])
