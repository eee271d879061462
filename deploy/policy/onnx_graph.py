"""Checks of an untrusted ONNX graph, before ONNX Runtime loads it."""

from collections.abc import Iterator

import numpy as np
import onnx
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
from onnx import AttributeProto, GraphProto, ModelProto, TensorProto, numpy_helper

from deploy.policy.onnx_fields import count_fields
from robots.errors import ContractError, printable

PARTS_MAX = 1 << 14
"""Nodes, their inputs, outputs and attributes, and tensors: a hundred times as many as networks of robots have."""
FIELDS_MAX = 1 << 18
"""Fields of an encoded model, and bytes of its lists of integers: decoded, they take up to 50 MB."""
RANDOM = frozenset(
    {"Bernoulli", "Multinomial", "RandomNormal", "RandomNormalLike", "RandomUniform", "RandomUniformLike"}
)
"""Operators that draw random numbers: a policy with them could not be replayed."""
TRAINING_MODE = 2
"""Place of the input of Dropout that makes it draw random numbers."""


def read_model(data: bytes, source: str) -> ModelProto:
    """Decode and check a model of unknown origin; `source` names the file in error messages.

    Raises:
        ContractError: it is not ONNX, or contains what a policy may not.
    """
    model = decode(data, source)
    check_model(model, source)
    return model


def decode(data: bytes, source: str) -> ModelProto:
    """Decode a model without checking it.

    Raises:
        ContractError: it is not ONNX, or has too many fields.
    """
    try:
        fields = count_fields(data, FIELDS_MAX)
    except ValueError as e:
        raise ContractError(
            f"{source}: not an ONNX file: its {len(data)} bytes cannot be decoded: {e}"
        ) from e
    if fields > FIELDS_MAX:
        counted = "fields and bytes of lists of integers"
        raise ContractError(f"{source}: found more than {FIELDS_MAX} {counted}: store weights in raw_data")
    try:
        return onnx.load_model_from_string(data)
    except DecodeError as e:
        raise ContractError(
            f"{source}: not an ONNX file: its {len(data)} bytes cannot be decoded: {shortened(e)}"
        ) from e


def check_model(model: ModelProto, source: str) -> None:
    """Refuse a model with forbidden content or an invalid graph.

    Raises:
        ContractError: names the part.
    """
    parts = sum(_parts_of(graph) for graph in graphs(model))
    if parts > PARTS_MAX:
        counted = "nodes, their inputs, outputs and attributes, and tensors"
        raise ContractError(f"{source}: found {parts} {counted}, at most {PARTS_MAX}")
    for complaint in _foreign(model):  # before the checker, which would follow external data
        raise ContractError(f"{source}: {complaint}")
    try:
        onnx.checker.check_model(model.SerializeToString())
    except (onnx.checker.ValidationError, UnicodeDecodeError, ValueError) as e:
        raise ContractError(f"{source}: not a valid ONNX model: {shortened(e)}") from e
    for graph in graphs(model):
        for tensor in tensors(graph):
            _check_finite(tensor, source)


def shortened(error: Exception) -> str:
    """Return a library's error message on one line, at most 300 characters, safe to print on a terminal."""
    return printable(" ".join(str(error).split()))[:300]


def type_name(kind: int) -> str:
    """Return the name of an element type; a file may hold any number."""
    known = dict(zip(TensorProto.DataType.values(), TensorProto.DataType.keys(), strict=True))
    return str(known.get(kind, f"kind {kind}"))


def graphs(model: ModelProto) -> Iterator[GraphProto]:
    """Yield the graph and the bodies of its Scan nodes."""
    yield model.graph
    for node in model.graph.node:
        yield from (attribute.g for attribute in node.attribute if attribute.type == AttributeProto.GRAPH)


def _parts_of(graph: GraphProto) -> int:
    """Return the number of a graph's parts, each of which is looked at several times."""
    named = (graph.input, graph.output, graph.value_info, graph.initializer, graph.sparse_initializer)
    in_nodes = (1 + len(node.attribute) + len(node.input) + len(node.output) for node in graph.node)
    return sum(map(len, named)) + sum(in_nodes)


def _foreign(model: ModelProto) -> Iterator[str]:
    """Yield complaints: external files, custom operators, random numbers, control flow but a Scan over robots."""
    for opset in model.opset_import:
        yield from _domain(opset.domain)
    if model.functions:
        yield "found functions, expected plain nodes"
    for graph in graphs(model):
        yield from _parts(graph, inner=graph is not model.graph)


def _parts(graph: GraphProto, *, inner: bool) -> Iterator[str]:
    if graph.sparse_initializer:
        yield "found sparse weights, expected dense weights"
    for tensor in tensors(graph):
        if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
            yield f"tensor {tensor.name!r:.100}: found external data, expected all weights in the one file"
    for node in graph.node:
        yield from _domain(node.domain)
        holds = any(a.type in (AttributeProto.GRAPH, AttributeProto.GRAPHS) for a in node.attribute)
        if holds and (inner or node.op_type != "Scan"):
            yield f"node {node.name!r:.100}: found {node.op_type:.100} with a graph of its own, expected none"
        if node.op_type in RANDOM or (node.op_type == "Dropout" and len(node.input) > TRAINING_MODE):
            yield (
                f"node {node.name!r:.100}: found {node.op_type:.100}, which may draw random numbers, expected the same"
                " outputs for the same inputs"
            )


def _domain(domain: str) -> Iterator[str]:
    if domain not in ("", "ai.onnx"):
        yield f"operator domain: found {domain!r:.100}, expected only ai.onnx"


def tensors(graph: GraphProto) -> Iterator[TensorProto]:
    """Yield all tensors of a graph, attributes of nodes included."""
    yield from graph.initializer
    for node in graph.node:
        for attribute in node.attribute:
            yield from ([attribute.t] if attribute.HasField("t") else [])
            yield from attribute.tensors
            sparse = [attribute.sparse_tensor] if attribute.HasField("sparse_tensor") else []
            for each in (*sparse, *attribute.sparse_tensors):
                yield from (each.values, each.indices)


def _check_finite(tensor: TensorProto, source: str) -> None:
    try:
        values = numpy_helper.to_array(tensor)
    except (ValueError, TypeError, KeyError) as e:
        raise ContractError(f"{source}: tensor {tensor.name!r:.100}: cannot be read: {shortened(e)}") from e
    numbers = tensor.data_type != TensorProto.STRING
    if numbers and (bad := int(values.size - np.isfinite(values).sum())):
        what = f"found {bad} of {values.size} weights NaN or infinite, expected all finite"
        raise ContractError(f"{source}: tensor {tensor.name!r:.100}: {what}")
