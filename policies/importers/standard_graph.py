"""ONNX graph with the standard inputs and outputs: (observation, memory) to (action, next_memory)."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import onnx
from onnx import GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto, helper, numpy_helper

from deploy.policy.policy_file import INPUT, MEMORY, NEXT, OUTPUT
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
        reference: the imported policy.
        columns, joints: permutations as in `contract_builder.BuiltContract`.
    """
    inner = onnx.compose.add_prefix(_strip_annotations(reference.model), PREFIX)
    build = _GraphBuilder()
    robot_size = sum(column != ABSENT for column in columns)
    source = INPUT if robot_size == len(columns) else build.append_zero(INPUT)
    observation = build.gather(
        source, [robot_size if column == ABSENT else column for column in columns], axis=1
    )
    scanned = bool(reference.memory) or not reference.batched
    action = (_scan_over_robots if scanned else _inline_batched)(build, inner.graph, reference, observation)
    build.identity(build.gather(action, joints, axis=1), OUTPUT)
    inputs, outputs = {INPUT: robot_size}, {OUTPUT: reference.facts.actions}
    if size := reference.memory_size:
        inputs[MEMORY] = outputs[NEXT] = size
    graph = helper.make_graph(
        build.nodes,
        "policy",
        [_tensor_info(*e) for e in inputs.items()],
        [_tensor_info(*e) for e in outputs.items()],
        build.weights,
    )
    version = max(IR_MIN, reference.model.ir_version)
    return helper.make_model(graph, opset_imports=reference.model.opset_import, ir_version=version)


def _strip_annotations(model: ModelProto) -> ModelProto:
    """Return a copy without comments, metadata, and shapes that hold for one batch size only."""
    plain = ModelProto()
    plain.CopyFrom(model)
    del plain.metadata_props[:], plain.graph.value_info[:]
    for part in (plain, plain.graph, *plain.graph.node, *plain.graph.initializer):
        part.ClearField("doc_string")
    for part in (plain.graph, *plain.graph.node, *plain.graph.initializer):
        part.ClearField("metadata_props")
    return plain


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
    body, size = _GraphBuilder(), reference.memory_size
    body.reshape("seen", [1, reference.facts.observations], PREFIX + reference.observation)
    ends = np.cumsum([0, *(memory.size for memory in reference.memory)])
    for (start, stop), memory in zip(pairwise(ends.tolist()), reference.memory, strict=True):
        part = body.add("Gather", ["known", body.integers(range(start, stop))], f"known_{start}", axis=0)
        body.reshape(part, memory.shape, PREFIX + memory.input_name)
    body.nodes.extend(inner.node)
    body.weights.extend(inner.initializer)
    body.reshape(PREFIX + reference.action, [reference.facts.actions], "done")
    flat = [
        body.reshape(PREFIX + m.output_name, [m.size], f"flat_{k}") for k, m in enumerate(reference.memory)
    ]
    inputs, outputs = (
        [_tensor_info("seen", reference.facts.observations, batch=False)],
        [_tensor_info("done", reference.facts.actions, batch=False)],
    )
    from_outside, to_outside = [observation], [f"{OUTPUT}_theirs"]
    if size:
        body.add("Concat", flat, "knows", axis=0)
        inputs.append(_tensor_info("known", size, batch=False))
        outputs.append(_tensor_info("knows", size, batch=False))
        from_outside.append(MEMORY)
        to_outside.append(NEXT)
    graph = helper.make_graph(body.nodes, "one_robot", inputs, outputs, body.weights)
    build.nodes.append(
        helper.make_node("Scan", from_outside, to_outside, body=graph, num_scan_inputs=len(from_outside))
    )
    return f"{OUTPUT}_theirs"


def _tensor_info(name: str, size: int, *, batch: bool = True) -> ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size] if batch else [size])
