"""Conversion of a torch module to an ONNX graph."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch
from onnx import ModelProto
from torch import Tensor, nn

from robots.errors import ContractError

OPSET = 18


def to_onnx(
    module: nn.Module,
    examples: tuple[Tensor, ...],
    inputs: Sequence[str],
    outputs: Sequence[str],
    shapes: dict[str, object] | None = None,
) -> ModelProto:
    """Return the ONNX graph of a module; deterministic for the same library versions.

    Args:
        module: to trace.
        examples: arguments. inputs, outputs: names.
        shapes: dynamic dimensions by argument.

    Raises:
        ContractError: torch gives no program.
    """
    with _quiet():
        program = torch.onnx.export(
            module,
            examples,
            input_names=inputs,
            output_names=outputs,
            opset_version=OPSET,
            dynamic_shapes=shapes,
            external_data=False,
            verbose=False,
        )
    if program is None:
        raise ContractError("torch.onnx.export gave no program")
    model = program.model_proto
    _strip(model)
    return model


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the exporter's warnings about optional libraries."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def _strip(model: ModelProto) -> None:
    """Remove torch's metadata: it has stack traces with local paths."""
    graph = model.graph
    del model.metadata_props[:], graph.value_info[:]
    for part in (model, graph, *graph.node, *graph.initializer, *graph.input, *graph.output):
        part.ClearField("doc_string")
    for part in (graph, *graph.node, *graph.initializer, *graph.input, *graph.output):
        part.ClearField("metadata_props")
