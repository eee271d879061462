"""Files of torch.save from anywhere: tensors, numbers and text; never code."""

import pickletools
import re
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from policies.importers.untrusted.pickle_reader import DICT, OPCODES_MAX, Inert, read_pickle
from policies.importers.untrusted.zip_archive import read_bytes, read_torch_members
from robots.errors import ContractError

NEEDED = re.compile(r"data\.pkl|byteorder|data/\d+")
NUMBERS = {
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
KNOWN = frozenset({DICT, *REBUILT, *(f"torch {name}" for name in NUMBERS)})
"""What the pickle of such a file may name."""


def load_tensors(path: Path, expected: str) -> object:
    """What a file holds; nothing in it is ever run. `expected` ends messages: "expected a checkpoint of …".

    Raises:
        ContractError: it is no such archive, is too large, or holds code.
    """
    return tensors_of(read_bytes(path, expected), str(path), expected)


def tensors_of(data: bytes, source: str, expected: str) -> object:
    """The same from the bytes of a file. Its pickle is walked, not run, and torch is given the numbers alone.

    Raises:
        ContractError: as `load_tensors` does.
    """
    members = read_torch_members(data, NEEDED, source, expected)
    if (pickled := members.get("data.pkl")) is None or members.get("byteorder", b"little") != b"little":
        raise ContractError(f"{source}: found no data.pkl with its least byte first, {expected}")
    source = f"{source}: data.pkl"
    if code := _globals(pickled, source) - KNOWN:
        found = ", ".join(repr(name.replace(" ", ".")) for name in sorted(code))
        only = "expected only tensors, numbers and text; nothing of it was run"
        raise ContractError(f"{source}: found {found:.300}, {only}")
    value = read_pickle(pickled, source)
    try:
        return _Rebuilt(members).of(value)
    except Exception as e:  # numbers of unknown origin can fail in any way
        raise ContractError(f"{source}: corrupt: a {type(e).__name__}") from e


def _globals(pickled: bytes, source: str) -> set[str]:
    """What a pickle would look up, had it been run."""
    try:
        return {
            str(argument) if opcode.name == "GLOBAL" else opcode.name
            for opcode, argument, _ in pickletools.genops(pickled)
            if opcode.name in ("GLOBAL", "STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4")
        }
    except Exception as e:  # bytes of unknown origin can fail in any way
        raise ContractError(f"{source}: corrupt: a {type(e).__name__}") from e


class _Rebuilt:
    """Plain values and tensors from the notes of a pickle; those that share numbers share them again."""

    def __init__(self, members: dict[str, bytes]) -> None:
        self._members, self._storages, self._seen = members, dict[tuple[str, str], Tensor](), 0

    def of(self, part: Any) -> Any:
        self._seen += 1
        if self._seen > OPCODES_MAX:  # few bytes can hold a thing twice in twice in twice, or in itself
            raise OverflowError
        match part:
            case dict():
                return {name: self.of(value) for name, value in part.items()}
            case list() | tuple():
                return type(part)(self.of(value) for value in part)
            case Inert(callee="torch._utils _rebuild_parameter", arguments=(inner, *_)):
                return self.of(inner)
            case Inert(
                callee="torch._utils _rebuild_tensor_v2",
                arguments=(storage, int(offset), tuple(size), tuple(stride), *_),
            ):
                return self._storage(storage).as_strided(size, stride, offset)
            case Inert():
                raise TypeError
        return part

    def _storage(self, note: Any) -> Tensor:
        match note:
            case Inert(callee="BINPERSID", arguments=[("storage", str(kind), str(key), _, _)]):
                if (kind, key) not in self._storages:
                    numbers = bytearray(self._members[f"data/{key}"])
                    dtype = NUMBERS[kind.removeprefix("torch ")]
                    self._storages[kind, key] = (
                        torch.frombuffer(numbers, dtype=dtype) if numbers else torch.empty(0, dtype=dtype)
                    )
                return self._storages[kind, key]
        raise TypeError


def check_tensor(tensor: Tensor, shape: tuple[int, ...], source: str) -> None:
    """Shape before values: a tensor of a few bytes can claim any number of elements.

    Raises:
        ContractError: it is not of this shape, not float32, not laid out plainly, or not finite.
    """
    plain = tensor.layout == torch.strided and tensor.device.type == "cpu" and tensor.is_contiguous()
    if tuple(tensor.shape) != shape or tensor.dtype != torch.float32 or not plain:
        found = f"{tensor.dtype} {tuple(tensor.shape)} {'contiguous' if plain else 'not plain'}"
        raise ContractError(f"{source}: found {found}, expected torch.float32 {shape} contiguous")
    if bad := int((~tensor.isfinite()).sum()):
        raise ContractError(f"{source}: found {bad} values NaN or infinite, expected all finite")
