"""Conversion of a torch module to an ONNX graph."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from tempfile import gettempdir
from typing import Any

import torch
from onnx import ModelProto
from torch import Tensor, nn

from deploy.operation.interrupts import not_dropped
from policies.export.onnx_file import strip_annotations
from robots.errors import ContractError

OPSET = 18


def to_onnx(
    module: nn.Module,
    examples: tuple[Tensor, ...],
    inputs: Sequence[str],
    outputs: Sequence[str],
    shapes: dict[str, object] | None = None,
) -> ModelProto:
    """Return the ONNX graph of a module called with `examples`; deterministic for the same library versions.

    `inputs` and `outputs` are names, `shapes` dynamic dimensions by argument.
    """
    settings: dict[str, Any] = {"opset_version": OPSET, "external_data": False, "verbose": False}
    settings |= {"input_names": inputs, "output_names": outputs, "dynamic_shapes": shapes}
    gettempdir()  # torch needs it, and tells nobody that there is none
    with _quiet(), not_dropped():  # it imports compilers, and goes on with what an interrupt has left of them
        program = torch.onnx.export(module, examples, **settings)
    if program is None:
        raise ContractError("torch.onnx.export gave no program")
    model = program.model_proto  # a new one at each access
    strip_annotations(model)
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
