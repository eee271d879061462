"""From a torch module to its ONNX graph."""

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
    """The same module gives the same graph, on any machine with the same library versions.

    Args:
        module: what to trace.
        examples: its arguments. inputs, outputs: names.
        shapes: dimensions that may vary, by argument.

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
    """The exporter warns of every library that it could use and that is not there."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def _strip(model: ModelProto) -> None:
    """Remove torch's notes: they hold stack traces with the paths of this machine."""
    graph = model.graph
    del model.metadata_props[:], graph.value_info[:]
    for part in (model, graph, *graph.node, *graph.initializer, *graph.input, *graph.output):
        part.ClearField("doc_string")
    for part in (graph, *graph.node, *graph.initializer, *graph.input, *graph.output):
        part.ClearField("metadata_props")
