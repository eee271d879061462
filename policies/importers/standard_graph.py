"""From a foreign graph to the ends that every policy file has: (observation, memory) to (action, next_memory)."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import onnx
from onnx import GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto, helper, numpy_helper

from deploy.policy.policy_file import INPUT, MEMORY, NEXT, OUTPUT
from policies.importers.reference_policy import STILL, Original

INSIDE = "policy/"
"""Before every name of the foreign graph, so that none is one of ours."""
IR_MIN = 4
"""From this version of ONNX on, weights need not be inputs."""


def with_our_ends(original: Original, columns: Sequence[int], joints: Sequence[int]) -> ModelProto:
    """One model with our ends, for a batch of any size.

    A graph for one robot, or one that remembers, becomes the body of a Scan over robots: it is asked for one after the
    other, as its owners ask it, and no robot can know of another.

    Args:
        original: the foreign policy.
        columns: (N,) which of our observation's numbers stands where in its own; STILL: none, but 0.
        joints: (A,) which of its action's numbers stands where in ours.
    """
    inner = onnx.compose.add_prefix(_plain(original.model), INSIDE)
    build = _Graph()
    ours = sum(column != STILL for column in columns)
    seen = INPUT if ours == len(columns) else build.with_zero(INPUT)
    observation = build.gather(seen, [ours if column == STILL else column for column in columns], axis=1)
    scanned = bool(original.memory) or not original.batched
    action = (_scanned if scanned else _joined)(build, inner.graph, original, observation)
    build.same(build.gather(action, joints, axis=1), OUTPUT)
    before, after = {INPUT: ours}, {OUTPUT: original.facts.actions}
    if size := original.memory_size:
        before[MEMORY] = after[NEXT] = size
    graph = helper.make_graph(
        build.nodes,
        "policy",
        [_info(*e) for e in before.items()],
        [_info(*e) for e in after.items()],
        build.weights,
    )
    version = max(IR_MIN, original.model.ir_version)
    return helper.make_model(graph, opset_imports=original.model.opset_import, ir_version=version)


def _plain(model: ModelProto) -> ModelProto:
    """Without what is only said, and without shapes that a batch of another size would break."""
    plain = ModelProto()
    plain.CopyFrom(model)
    del plain.metadata_props[:], plain.graph.value_info[:]
    for part in (plain, plain.graph, *plain.graph.node, *plain.graph.initializer):
        part.ClearField("doc_string")
    for part in (plain.graph, *plain.graph.node, *plain.graph.initializer):
        part.ClearField("metadata_props")
    return plain


class _Graph:
    """Nodes and weights under construction."""

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

    def same(self, value: str, output: str) -> str:
        return self.add("Identity", [value], output)

    def gather(self, value: str, indices: Sequence[int], *, axis: int) -> str:
        if list(indices) == list(range(len(indices))):
            return value
        return self.add("Gather", [value, self.integers(indices)], f"{value}_ordered", axis=axis)

    def with_zero(self, value: str) -> str:
        """One more column, of 0 for each robot."""
        first = self.add("Gather", [value, self.integers([0])], f"{value}_first", axis=1)
        zero = self.add("Sub", [first, first], f"{value}_zero")
        return self.add("Concat", [value, zero], f"{value}_and_zero", axis=1)

    def shaped(self, value: str, shape: Sequence[int], output: str) -> str:
        return self.add("Reshape", [value, self.integers(shape)], output)


def _joined(build: _Graph, inner: GraphProto, original: Original, observation: str) -> str:
    """All robots at once."""
    build.same(observation, INSIDE + original.observation)
    build.nodes.extend(inner.node)
    build.weights.extend(inner.initializer)
    return INSIDE + original.action


def _scanned(build: _Graph, inner: GraphProto, original: Original, observation: str) -> str:
    """One robot after the other."""
    body, size = _Graph(), original.memory_size
    body.shaped("seen", [1, original.facts.observations], INSIDE + original.observation)
    ends = np.cumsum([0, *(memory.size for memory in original.memory)])
    for (start, stop), memory in zip(pairwise(ends.tolist()), original.memory, strict=True):
        part = body.add("Gather", ["known", body.integers(range(start, stop))], f"known_{start}", axis=0)
        body.shaped(part, memory.shape, INSIDE + memory.before)
    body.nodes.extend(inner.node)
    body.weights.extend(inner.initializer)
    body.shaped(INSIDE + original.action, [original.facts.actions], "done")
    flat = [body.shaped(INSIDE + m.after, [m.size], f"flat_{k}") for k, m in enumerate(original.memory)]
    inputs, outputs = (
        [_info("seen", original.facts.observations, batch=False)],
        [_info("done", original.facts.actions, batch=False)],
    )
    from_outside, to_outside = [observation], [f"{OUTPUT}_theirs"]
    if size:
        body.add("Concat", flat, "knows", axis=0)
        inputs.append(_info("known", size, batch=False))
        outputs.append(_info("knows", size, batch=False))
        from_outside.append(MEMORY)
        to_outside.append(NEXT)
    graph = helper.make_graph(body.nodes, "one_robot", inputs, outputs, body.weights)
    build.nodes.append(
        helper.make_node("Scan", from_outside, to_outside, body=graph, num_scan_inputs=len(from_outside))
    )
    return f"{OUTPUT}_theirs"


def _info(name: str, size: int, *, batch: bool = True) -> ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size] if batch else [size])
