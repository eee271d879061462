"""Reader of untrusted torch.save files: tensors, numbers and text; no code is run, files that hold code are refused."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from policies.importers.untrusted.pickle_reader import (
    DICT,
    OPCODES_MAX,
    PickleRules,
    UnresolvedCall,
    read_pickle,
)
from policies.importers.untrusted.zip_archive import read_bytes, read_torch_members
from robots.errors import ContractError

NEEDED = re.compile(r"data\.pkl|byteorder|data/\d+")
DTYPES = {
    "DoubleStorage": torch.float64,
    "FloatStorage": torch.float32,
    "HalfStorage": torch.float16,
    "BFloat16Storage": torch.bfloat16,
    "LongStorage": torch.int64,
    "IntStorage": torch.int32,
    "ShortStorage": torch.int16,
    "CharStorage": torch.int8,
    "ByteStorage": torch.uint8,
    "BoolStorage": torch.bool,
}
REBUILT = {"torch._utils _rebuild_tensor_v2", "torch._utils _rebuild_parameter"}
KNOWN = frozenset({DICT, *REBUILT, *(f"torch {name}" for name in DTYPES)})
"""Globals that the pickle of such a file may name."""


def load_tensors(path: Path, expected: str) -> object:
    """Return the contents of a torch.save file. `expected` ends error messages: "expected a checkpoint of …"."""
    return parse_tensors(read_bytes(path, expected), str(path), expected)


def parse_tensors(data: bytes, source: str, expected: str) -> object:
    """Return the contents of the bytes of a torch.save file. Torch gets only the numbers, never the pickle."""
    members = read_torch_members(data, NEEDED, source, expected)
    if (pickled := members.get("data.pkl")) is None or members.get("byteorder", b"little") != b"little":
        raise ContractError(f"{source}: found no data.pkl in little-endian byte order, {expected}")
    source = f"{source}: data.pkl"
    value = read_pickle(pickled, source, PickleRules(check_global=_check_global))
    try:
        return _TensorBuilder(members).build(value)
    except Exception as e:  # numbers of unknown origin can fail in any way
        raise ContractError(f"{source}: corrupt: a {type(e).__name__}") from e


def _check_global(name: str) -> str | None:
    if name in KNOWN:
        return None
    return f"found {name.replace(' ', '.')!r:.300}, expected only tensors, numbers and text"


class _TensorBuilder:
    """Build plain values and tensors from a parsed pickle; tensors that share a storage share it again."""

    def __init__(self, members: dict[str, bytes]) -> None:
        self._members, self._storages, self._steps = members, dict[tuple[str, str], Tensor](), 0

    def build(self, part: Any) -> Any:
        self._steps += 1
        if self._steps > OPCODES_MAX:  # a value may contain itself, or grow exponentially by references
            raise OverflowError
        match part:
            case dict():
                return {name: self.build(value) for name, value in part.items()}
            case list() | tuple():
                return type(part)(self.build(value) for value in part)
            case UnresolvedCall(callee="torch._utils _rebuild_parameter", arguments=(inner, *_)):
                return self.build(inner)
            case UnresolvedCall(
                callee="torch._utils _rebuild_tensor_v2",
                arguments=(storage, int(offset), tuple(size), tuple(stride), *_),
            ):
                return self._storage(storage).as_strided(size, stride, offset)
            case UnresolvedCall():
                raise TypeError
        return part

    def _storage(self, call: Any) -> Tensor:
        match call:
            case UnresolvedCall(callee="BINPERSID", arguments=[("storage", str(kind), str(key), _, _)]):
                if (kind, key) not in self._storages:
                    numbers = bytearray(self._members[f"data/{key}"])
                    dtype = DTYPES[kind.removeprefix("torch ")]
                    found = torch.frombuffer(numbers, dtype=dtype) if numbers else torch.empty(0, dtype=dtype)
                    self._storages[kind, key] = found
                return self._storages[kind, key]
        raise TypeError


def check_tensors(found: Mapping[str, Tensor], shapes: Mapping[str, tuple[int, ...]], source: str) -> None:
    """Refuse other tensors than those named in `shapes`, and those that `check_tensor` refuses."""
    if found.keys() != shapes.keys():
        raise ContractError(f"{source}: found tensors {sorted(found)!s:.300}, expected {sorted(shapes)}")
    for name, shape in shapes.items():
        check_tensor(found[name], shape, f"{source}.{name}")


def check_tensor(tensor: Tensor, shape: tuple[int, ...], source: str) -> None:
    """Refuse a tensor that is not float32, contiguous, finite and of this shape.

    The shape is checked before the values: a tensor of a few bytes can claim any number of elements.
    """
    plain = tensor.layout == torch.strided and tensor.device.type == "cpu" and tensor.is_contiguous()
    if tuple(tensor.shape) != shape or tensor.dtype != torch.float32 or not plain:
        found = f"{tensor.dtype} {tuple(tensor.shape)} {'contiguous' if plain else 'not contiguous'}"
        raise ContractError(f"{source}: found {found}, expected torch.float32 {shape} contiguous")
    if bad := int((~tensor.isfinite()).sum()):
        raise ContractError(f"{source}: found {bad} values NaN or infinite, expected all finite")
