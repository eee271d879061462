"""Bounds on the memory and work of an ONNX graph, from inferred shapes, before ONNX Runtime loads it.

ONNX Runtime computes constant parts while it loads a graph, so no file may reach it unmeasured. Declared shapes of
intermediate tensors are not trusted: all are inferred from inputs and weights, for a batch of each size.
"""

from collections import ChainMap
from collections.abc import Sequence
from typing import Any, NamedTuple

from onnx import GraphProto, ModelProto, NodeProto, helper

from deploy.policy.graph_work import NODE_WORK, node_work
from deploy.policy.node_checks import check_node
from deploy.policy.shape_inference import NUMBERS, Tensor, add_weights, infer_outputs
from robots.errors import ContractError

ELEMENTS_MAX = 1 << 26
"""Elements of one tensor: as many as the largest file has weights of single precision."""
BYTES_MAX = 1 << 30
"""Bytes of all intermediate tensors of a step together: with the weights, an eighth of a small computer's memory."""
WORK_MAX = 1 << 26
"""Multiply-adds of a step of one robot: as many as the largest file has weights; 10 ms of a core, or 1 s of sines."""
TRIPS_MAX = 1 << 12
"""Trips of one Scan, over robots or over the steps of a history."""
SCAN_OPSET_MIN = 9
"""First operator set in which Scan has no batch axis."""


class _Usage(NamedTuple):
    """Bytes of the intermediate tensors, and work, of a step of a graph."""

    bytes: int
    work: int


def check_bounds(model: ModelProto, batches: Sequence[int], source: str) -> None:
    """Refuse a graph that may need too much memory or work for a step of as many robots as one of `batches`.

    It has passed `onnx_graph.check_model`.

    Raises:
        ContractError: names the node or tensor, what was found, and the bound.
    """
    opset = max(each.version for each in model.opset_import)
    for batch in batches:
        where = f"{source}: for a batch of {batch}"
        found = _usage(model.graph, _inputs(model.graph, batch, where), opset, where)
        _check_at_most(found.bytes, BYTES_MAX, "bytes of intermediate tensors", where)
        _check_at_most(found.work, WORK_MAX * batch, "multiply-adds in a step", where)


def _inputs(graph: GraphProto, batch: int, where: str) -> ChainMap[str, Tensor]:
    """Return the inputs of a graph; dimensions of any size are those of the batch."""
    known = ChainMap({"": Tensor()})
    for value in graph.input:
        kind = value.type.tensor_type
        if kind.elem_type not in NUMBERS or not kind.HasField("shape"):
            raise ContractError(f"{where}: input {value.name!r:.100}: found no numbers of a known rank")
        dims = (dim.dim_value if dim.HasField("dim_value") else batch for dim in kind.shape.dim)
        known[value.name] = Tensor(kind.elem_type, tuple(dims))
    return known


def _usage(graph: GraphProto, known: ChainMap[str, Tensor], opset: int, where: str) -> _Usage:
    """Return what a step of a graph needs, and add its tensors to `known`, which has its inputs."""
    add_weights(graph, known, where)
    need_bytes = need_work = 0
    for node in graph.node:
        name = f"{where}: node {node.name or ''.join(node.output[:1])!r:.100} ({node.op_type:.100})"
        if unknown := [each for each in node.input if each not in known]:
            raise ContractError(f"{name}: found an input {unknown[0]!r:.100} that is computed nowhere")
        check_node(node, known, name)
        if node.op_type == "Scan":
            outputs, inner = _scan(node, known, opset, name)
        else:
            outputs, inner = infer_outputs(node, known, opset, name), _Usage(0, 0)
        for tensor in outputs:
            _check_at_most(tensor.elements, ELEMENTS_MAX, "elements of an output", name)
        need_bytes += sum(tensor.bytes for tensor in outputs) + inner.bytes
        need_work += node_work(node, [known[each] for each in node.input], outputs) + inner.work
        known.update({each: tensor for each, tensor in zip(node.output, outputs, strict=True) if each})
    return _Usage(need_bytes, need_work)


def _scan(
    node: NodeProto, known: ChainMap[str, Tensor], opset: int, where: str
) -> tuple[list[Tensor], _Usage]:
    """Return the outputs of a Scan, and what its body needs: the memory of one trip, the work of all."""
    fields: dict[str, Any] = {each.name: helper.get_attribute_value(each) for each in node.attribute}
    body, count = fields["body"], fields["num_scan_inputs"]
    states = len(node.input) - count
    joined_count = len(node.output) - states
    fits = count > 0 <= min(states, joined_count)
    fits &= len(body.input) == len(node.input) and len(body.output) == len(node.output)
    axes_in, axes_out = (
        fields.get(name) or [0] * (number if fits else 0)
        for name, number in (("scan_input_axes", count), ("scan_output_axes", joined_count))
    )
    fits &= len(axes_in) == count and len(axes_out) == joined_count
    if opset < SCAN_OPSET_MIN or not fits:
        raise ContractError(
            f"{where}: found other inputs, outputs or axes than its graph has, or no operator set 9"
        )
    given = [known[name] for name in node.input]
    parts = [_without(tensor, axis, where) for tensor, axis in zip(given[states:], axes_in, strict=True)]
    trips = max(size for size, _ in parts)
    _check_at_most(trips, TRIPS_MAX, "trips", where)
    starts = [*given[:states], *(part for _, part in parts)]
    inner = known.new_child(
        {value.name: Tensor(each.kind, each.dims) for value, each in zip(body.input, starts, strict=True)}
    )
    usage = _usage(body, inner, opset, where)
    ends = [inner[value.name] for value in body.output]
    if any(end.dims != state.dims for end, state in zip(ends, given[:states], strict=False)):
        raise ContractError(f"{where}: found a state that changes its shape, expected the same in every trip")
    joined = [_joined(end, axis, trips) for end, axis in zip(ends[states:], axes_out, strict=True)]
    states_after = [Tensor(each.kind, each.dims) for each in given[:states]]  # other values than before
    return [*states_after, *joined], _Usage(usage.bytes, trips * (usage.work + NODE_WORK))


def _without(tensor: Tensor, axis: int, where: str) -> tuple[int, Tensor]:
    """Return the size of an axis, and one part of a tensor along it."""
    if not -len(tensor.dims) <= axis < len(tensor.dims):
        raise ContractError(f"{where}: found axis {axis} of a tensor of {len(tensor.dims)} dimensions")
    dims = list(tensor.dims)
    return dims.pop(axis), Tensor(tensor.kind, tuple(dims))


def _joined(tensor: Tensor, axis: int, trips: int) -> Tensor:
    """Return as many such tensors along a new axis."""
    place = axis if axis >= 0 else axis + len(tensor.dims) + 1
    return Tensor(tensor.kind, (*tensor.dims[:place], trips, *tensor.dims[place:]))


def _check_at_most(found: int, bound: int, unit: str, where: str) -> None:
    if found > bound:
        raise ContractError(f"{where}: found {found} {unit}, expected at most {bound}")
