"""Bounds on the memory and work of an ONNX graph, from inferred shapes, before ONNX Runtime loads it.

ONNX Runtime computes constant parts while it loads a graph, so no file may reach it unmeasured. Declared shapes of
intermediate tensors are not trusted: all are inferred anew from inputs and weights, for a batch of each size.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import onnx
from onnx import AttributeProto, GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto, helper

from deploy.policy.graph_work import NODE_WORK, Tensor, node_work
from robots.errors import ContractError, printable

ELEMENTS_MAX = 1 << 26
"""Elements of one tensor: as many as the largest file has weights of single precision."""
BYTES_MAX = 1 << 30
"""Bytes of all intermediate tensors of a step together: with the weights, an eighth of a small computer's memory."""
WORK_MAX = 1 << 26
"""Multiply-adds of a step of one robot: as many as the largest file has weights; 10 ms of a core, or 1 s of sines."""
TRIPS_MAX = 1 << 12
"""Trips of one Scan, over robots or over the steps of a history."""
VALUES_MAX = 1 << 10
"""Elements of a weight whose values, such as those of a shape, take part in the inference of shapes."""
NUMBERS = frozenset(helper.get_all_tensor_dtypes()) - {TensorProto.STRING}
"""Types of elements that have a fixed size."""
IR_MIN = 4
"""First IR version in which weights need not be inputs."""


class _Usage(NamedTuple):
    """Bytes of the intermediate tensors, and work, of a step of a graph."""

    bytes: int
    work: int


def check_bounds(model: ModelProto, batches: Sequence[int], source: str) -> None:
    """Refuse a graph that may need too much memory or work for a step of as many robots as one of `batches`.

    Raises:
        ContractError: names the node or tensor, what was found, and the bound.
    """
    for batch in batches:
        where = f"{source}: for a batch of {batch}"
        graph = _infer(model, batch, where)
        found = _usage(graph, {}, where)
        _check_at_most(found.bytes, BYTES_MAX, "bytes of intermediate tensors", where)
        _check_at_most(found.work, WORK_MAX * batch, "multiply-adds in a step", where)


def _infer(model: ModelProto, batch: int, where: str) -> GraphProto:
    """Return the graph with inferred shapes, without large weights."""
    outline = ModelProto(ir_version=max(IR_MIN, model.ir_version), opset_import=model.opset_import)
    outline.graph.CopyFrom(_outline(model.graph))
    for value in outline.graph.input:
        for dim in value.type.tensor_type.shape.dim:
            if not dim.HasField("dim_value"):
                dim.dim_value = batch
    try:
        return onnx.shape_inference.infer_shapes(outline, strict_mode=True, data_prop=True).graph
    except Exception as e:  # shapes of unknown origin can fail in any way
        message = printable(" ".join(str(e).split()))
        raise ContractError(f"{where}: shapes cannot be inferred: {message:.300}") from e


def _outline(graph: GraphProto, *, inner: bool = False) -> GraphProto:
    """Return a graph without declared shapes, but those of inputs, and without the values of large weights."""
    weights = {tensor.name for tensor in graph.initializer}
    outline = GraphProto(name=graph.name, initializer=map(_without_values, graph.initializer))
    outline.input.extend(value for value in graph.input if inner or value.name not in weights)
    outline.output.extend(graph.output)
    for value in (*outline.output, *(outline.input if inner else ())):
        value.ClearField("type")
    for number, node in enumerate(graph.node):
        outline.node.add().CopyFrom(node)
        for attribute in outline.node[-1].attribute:
            if attribute.type == AttributeProto.GRAPH:
                attribute.g.CopyFrom(_outline(attribute.g, inner=True))
                _rename(attribute.g, f"{_unused_prefix(graph)}{number}/")
    return outline


def _unused_prefix(graph: GraphProto) -> str:
    """Return a prefix that no name of a graph has."""
    prefix = "/"
    while any(name.startswith(prefix) for name in _own_names(graph)):
        prefix += "/"
    return prefix


def _own_names(graph: GraphProto) -> set[str]:
    """Return the names that a graph gives: of inputs, weights and outputs of nodes."""
    parts = {part.name for part in (*graph.input, *graph.initializer)}
    return parts | {name for node in graph.node for name in node.output if name}


def _rename(graph: GraphProto, prefix: str) -> None:
    """Rename what a graph calls by a name of its own: inference would confuse it with the same name outside."""
    own = _own_names(graph)
    for part in (*graph.input, *graph.output, *graph.initializer):
        part.name = prefix + part.name
    for node in graph.node:
        node.input[:] = [prefix + name if name in own else name for name in node.input]
        node.output[:] = [name and prefix + name for name in node.output]


def _without_values(tensor: TensorProto) -> TensorProto:
    if math.prod(tensor.dims) <= VALUES_MAX:
        return tensor
    return TensorProto(name=tensor.name, data_type=tensor.data_type, dims=tensor.dims)


def _usage(graph: GraphProto, outside: Mapping[str, Tensor], where: str) -> _Usage:
    """Return what a step of a graph needs; `outside` are the tensors of the graph around it."""
    tensors = {"": Tensor(), **outside, **dict(_tensors(graph, where))}
    need_bytes = need_work = 0
    for node in graph.node:
        name = f"{where}: node {node.name or node.output[0]!r:.100} ({node.op_type:.100})"
        if unknown := [output for output in node.output if output not in tensors]:
            expected = "expected one that follows from the shapes of the inputs"
            raise ContractError(f"{name}: found an output {unknown[0]!r:.100} of unknown shape, {expected}")
        outputs = [tensors[output] for output in node.output]
        for tensor in outputs:
            _check_at_most(tensor.elements, ELEMENTS_MAX, "elements of an output", name)
        inner = _scan(node, tensors, name) if node.op_type == "Scan" else _Usage(0, 0)
        need_bytes += sum(tensor.bytes for tensor in outputs) + inner.bytes
        need_work += node_work(node, [tensors[each] for each in node.input], outputs) + inner.work
    return _Usage(need_bytes, need_work)


def _scan(node: NodeProto, tensors: Mapping[str, Tensor], where: str) -> _Usage:
    """Return what the body of a Scan needs: the memory of one trip, the work of all."""
    fields = {attribute.name: helper.get_attribute_value(attribute) for attribute in node.attribute}
    scanned = node.input[-fields["num_scan_inputs"] :]
    axes = fields.get("scan_input_axes") or [0] * len(scanned)
    trips = max(tensors[name].dims[axis] for name, axis in zip(scanned, axes, strict=True))
    _check_at_most(trips, TRIPS_MAX, "trips", where)
    body = _usage(fields["body"], tensors, where)
    return _Usage(body.bytes, trips * (body.work + NODE_WORK))


def _tensors(graph: GraphProto, where: str) -> Iterator[tuple[str, Tensor]]:
    """Yield the tensors of a graph whose shapes are known, by name."""
    values: Iterable[ValueInfoProto] = (*graph.input, *graph.output, *graph.value_info)
    for value in values:
        kind = value.type.tensor_type
        if not value.type.HasField("tensor_type") or kind.elem_type not in NUMBERS:
            raise ContractError(
                f"{where}: {value.name!r:.100}: found no numbers, expected a tensor of numbers"
            )
        if kind.HasField("shape") and all(dim.HasField("dim_value") for dim in kind.shape.dim):
            yield value.name, Tensor.of(kind.elem_type, [dim.dim_value for dim in kind.shape.dim])
    for tensor in graph.initializer:
        yield tensor.name, Tensor.of(tensor.data_type, tensor.dims)


def _check_at_most(found: int, bound: int, unit: str, where: str) -> None:
    if found > bound:
        raise ContractError(f"{where}: found {found} {unit}, expected at most {bound}")
