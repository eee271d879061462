"""What an ONNX graph may hold, checked before ONNX Runtime is asked to run it."""

from collections.abc import Iterator

import numpy as np
import onnx
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
from onnx import AttributeProto, GraphProto, ModelProto, TensorProto, numpy_helper

from robots.errors import ContractError, printable


def read_model(data: bytes, source: str) -> ModelProto:
    """A model from bytes of unknown origin; `source` names the file in messages.

    Raises:
        ContractError: it is no ONNX, or holds what a policy may not.
    """
    model = decode(data, source)
    check_model(model, source)
    return model


def decode(data: bytes, source: str) -> ModelProto:
    """A model of which nothing is known yet.

    Raises:
        ContractError: it is no ONNX.
    """
    try:
        return onnx.load_model_from_string(data)
    except DecodeError as e:
        raise ContractError(f"{source}: not an ONNX file: its {len(data)} bytes cannot be decoded") from e


def check_model(model: ModelProto, source: str) -> None:
    """Refuse what a policy may not hold, and what is no valid graph.

    Raises:
        ContractError: naming the part of it.
    """
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
    """What a library says about a file, on one line, and nothing in it that would upset a terminal."""
    return printable(" ".join(str(error).split()))[:300]


def graphs(model: ModelProto) -> Iterator[GraphProto]:
    """The graph, and what its Scans do for one robot after the other."""
    yield model.graph
    for node in model.graph.node:
        yield from (attribute.g for attribute in node.attribute if attribute.type == AttributeProto.GRAPH)


def _foreign(model: ModelProto) -> Iterator[str]:
    """Other files, own operators, steps of unknown cost: only a Scan, which ends with its robots, holds a graph."""
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
            yield f"tensor {tensor.name!r}: found external data, expected all weights in the one file"
    for node in graph.node:
        yield from _domain(node.domain)
        holds = any(a.type in (AttributeProto.GRAPH, AttributeProto.GRAPHS) for a in node.attribute)
        if holds and (inner or node.op_type != "Scan"):
            yield f"node {node.name!r}: found {node.op_type} with a graph of its own, expected none"


def _domain(domain: str) -> Iterator[str]:
    if domain not in ("", "ai.onnx"):
        yield f"operator domain: found {domain!r}, expected only ai.onnx"


def tensors(graph: GraphProto) -> Iterator[TensorProto]:
    """All weights of a graph, those inside its nodes too."""
    yield from graph.initializer
    for node in graph.node:
        for attribute in node.attribute:
            yield from ([attribute.t] if attribute.HasField("t") else [])
            yield from attribute.tensors


def _check_finite(tensor: TensorProto, source: str) -> None:
    try:
        values = numpy_helper.to_array(tensor)
    except (ValueError, TypeError, KeyError) as e:
        raise ContractError(f"{source}: tensor {tensor.name!r}: cannot be read: {shortened(e)}") from e
    if not np.issubdtype(values.dtype, np.floating):
        return
    if bad := int(values.size - np.isfinite(values).sum()):
        what = f"found {bad} of {values.size} weights NaN or infinite, expected all finite"
        raise ContractError(f"{source}: tensor {tensor.name!r}: {what}")
