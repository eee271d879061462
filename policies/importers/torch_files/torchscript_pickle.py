"""The pickles inside TorchScript files, looked through before torch's own C++ reader is given them."""

import pickletools
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from robots.errors import ContractError

OPCODES_MAX = 1_000_000
SIZES = {
    **dict.fromkeys(("BoolStorage", "ByteStorage", "CharStorage"), 1),
    **dict.fromkeys(("HalfStorage", "BFloat16Storage", "ShortStorage"), 2),
    **dict.fromkeys(("FloatStorage", "IntStorage"), 4),
    **dict.fromkeys(("DoubleStorage", "LongStorage"), 8),
}
"""Bytes of a number."""
MODULES = frozenset({"torch.jit._pickle"})
GLOBALS = frozenset(
    {"torch._utils _rebuild_tensor_v2", "collections OrderedDict", *(f"torch {name}" for name in SIZES)}
)
ATOMS = frozenset({"BINUNICODE", "BININT", "BININT1", "BININT2", "LONG1", "GLOBAL"})
GETS = frozenset({"BINGET", "LONG_BINGET"})
KNOWN = ATOMS | GETS


def check_pickle(data: bytes, storages: Mapping[str, bytes], source: str) -> None:
    """Refuse classes other than the file's own, and tensors that reach past the bytes they have.

    Args:
        data: the pickle.
        storages: numbers of its tensors, by the names that it calls them by.

    Raises:
        ContractError: naming what was found.
    """
    walk = _Walk(storages)
    try:
        for count, (opcode, argument, _) in enumerate(pickletools.genops(data)):
            for complaint in walk.step(opcode.name, argument, count):
                raise ContractError(f"{source}: {complaint}; nothing of it was run")
    except ContractError:
        raise
    except Exception as e:  # bytes of unknown origin can fail in any way
        raise ContractError(f"{source}: found no pickle that can be read: a {type(e).__name__}") from e


class _Walk:
    """Torch does not compare a storage with its bytes, so each is to be spelled out as its writer does it."""

    def __init__(self, storages: Mapping[str, bytes]) -> None:
        self._storages = storages
        self._atoms: list[object] = []  # since the last mark; None: not known
        self._memo: dict[int, object] = {}
        self._before = ""

    def step(self, name: str, argument: Any, count: int) -> Iterator[str]:
        """What is wrong with one opcode."""
        if name in ("BINPUT", "LONG_BINPUT"):
            if argument > count or count > OPCODES_MAX:
                yield f"found step {count} to remember thing {argument}, expected fewer"
            self._memo[argument] = self._atoms[-1] if self._before in KNOWN else None
            return
        if name == "GLOBAL":
            yield from _global(argument)
        if name == "BINPERSID":
            yield from _storage(self._atoms if self._before == "TUPLE" else [], self._storages)
        self._push(name, argument)
        self._before = name

    def _push(self, name: str, argument: Any) -> None:
        if name in ATOMS:
            self._atoms.append(argument)
        elif name in GETS:
            self._atoms.append(self._memo.get(argument))
        elif name != "TUPLE":
            self._atoms = [] if name == "MARK" else [None]


def _global(name: str) -> Iterator[str]:
    module = name.partition(" ")[0]
    own = module.partition(".")[0] == "__torch__" and not module.startswith("__torch__.torch.classes")
    if not own and module not in MODULES and name not in GLOBALS:
        yield f"found {name!r:.100}, expected only the file's own classes, and tensors"


def _storage(atoms: Collection[object], storages: Mapping[str, bytes]) -> Iterator[str]:
    word, kind, key, _, numbers = atoms if len(atoms) == 5 else [None] * 5
    size = SIZES.get(str(kind).removeprefix("torch "), 0)
    if word != "storage" or not size or not isinstance(numbers, int) or str(key) not in storages:
        yield f"found {list(atoms)!r:.100}, expected a storage of numbers"
    elif not 0 <= numbers * size <= len(storages[str(key)]):
        yield f"tensor {key}: found {len(storages[str(key)])} bytes, expected {numbers * size}"
