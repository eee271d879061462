"""Mutation of ONNX: any field of its messages, the JSON in its metadata, and nodes that are inserted."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from google.protobuf.descriptor import FieldDescriptor  # type: ignore[import-untyped]
from google.protobuf.message import Message  # type: ignore[import-untyped]
from onnx import ModelProto

from eval.fuzz.onnx_node import insert_node
from eval.fuzz.text import mutate_text

WORDS = (
    *("", "x", "observation", "action", "\x1b[2J", "evil", "x" * 10_000),
    *(
        "MatMul",
        "Gemm",
        "Conv",
        "ConstantOfShape",
        "Expand",
        "Tile",
        "Range",
        "Scan",
        "Loop",
        "If",
        "LSTM",
        "Reshape",
    ),
    *(
        "Einsum",
        "Pad",
        "Resize",
        "Split",
        "Gather",
        "NonZero",
        "TopK",
        "CumSum",
        "DFT",
        "MaxPool",
        "Concat",
        "Slice",
    ),
)
"""Names, and operators whose results grow or whose shapes are computed."""
NUMBERS = (
    0,
    1,
    -1,
    2,
    3,
    7,
    8,
    64,
    1000,
    1 << 20,
    1 << 31,
    (1 << 31) - 1,
    1 << 40,
    (1 << 63) - 1,
    -(1 << 63),
)
INSERTION_SHARE = 0.2
"""Part of the cases in which a node is inserted and nothing else is changed."""


def mutate_onnx(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a model with one to three of its fields changed, removed, copied or exchanged, or with another node."""
    model = ModelProto.FromString(data)
    if rng.random() < INSERTION_SHARE:
        insert_node(model.graph, rng)
        return bytes(model.SerializeToString())
    for _ in range(rng.integers(1, 4)):
        places = list(_fields(model))
        message, field = places[rng.integers(len(places))]
        _change(message, field, rng)
    return bytes(model.SerializeToString())


def _fields(message: Message) -> Iterator[tuple[Message, FieldDescriptor]]:
    """Yield each field that is set, in this message and those in it."""
    for field, value in message.ListFields():
        yield message, field
        if field.type == FieldDescriptor.TYPE_MESSAGE:
            for inner in value if field.is_repeated else [value]:
                yield from _fields(inner)


def _change(message: Message, field: FieldDescriptor, rng: np.random.Generator) -> None:
    value = getattr(message, field.name)
    if rng.integers(8) == 0:
        message.ClearField(field.name)
    elif field.is_repeated:
        _change_list(value, field, rng)
    elif field.type != FieldDescriptor.TYPE_MESSAGE:
        _set(message, field, _other(value, rng))


def _set(message: Message, field: FieldDescriptor, value: Any) -> None:
    """Set a field, or leave it where the value does not fit its type."""
    try:
        setattr(message, field.name, value)
    except (TypeError, ValueError):
        message.ClearField(field.name)


def _change_list(values: Any, field: FieldDescriptor, rng: np.random.Generator) -> None:
    one, other = (int(rng.integers(len(values))) for _ in range(2))
    kind = rng.integers(3)
    if kind == 0:
        del values[one]
    elif field.type == FieldDescriptor.TYPE_MESSAGE:
        values.add().CopyFrom(values[one]) if kind == 1 else values[one].CopyFrom(values[other])
    elif kind == 1:
        values.append(values[one])
    else:
        new = _other(values[one], rng)
        values[one] = new if isinstance(new, type(values[one])) else values[other]


def _other(value: Any, rng: np.random.Generator) -> Any:
    if isinstance(value, bytes):
        return value[: rng.integers(len(value) + 1)] + rng.bytes(int(rng.integers(9)))
    if isinstance(value, str):
        if value.startswith("{"):
            return mutate_text(value.encode(), rng).decode(errors="replace")
        return WORDS[rng.integers(len(WORDS))]
    if isinstance(value, float):
        return (0.0, -1.0, 1e38, float("nan"), float("inf"))[rng.integers(5)]
    return NUMBERS[rng.integers(len(NUMBERS))]
