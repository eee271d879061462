"""Check of the pickles inside TorchScript files, before torch's own C++ reader gets them."""

from collections.abc import Mapping

from policies.importers.untrusted.pickle_reader import PickleRules, read_pickle

OPCODES_MAX = 1_000_000
SIZES = {
    **dict.fromkeys(("BoolStorage", "ByteStorage", "CharStorage"), 1),
    **dict.fromkeys(("HalfStorage", "BFloat16Storage", "ShortStorage"), 2),
    **dict.fromkeys(("FloatStorage", "IntStorage"), 4),
    **dict.fromkeys(("DoubleStorage", "LongStorage"), 8),
}
"""Bytes per number."""
GLOBALS = frozenset(
    {"torch._utils _rebuild_tensor_v2", "collections OrderedDict", *(f"torch {name}" for name in SIZES)}
)


def check_pickle(data: bytes, storages: Mapping[str, bytes], source: str) -> None:
    """Refuse classes other than the file's own, and tensors larger than their bytes, which torch does not compare.

    Args:
        data: the pickle.
        storages: bytes of the tensors by the names that the pickle gives them.

    Raises:
        ContractError: naming what was found.
    """
    rules = PickleRules(_check_global, lambda identifier: _check_storage(identifier, storages), OPCODES_MAX)
    read_pickle(data, source, rules)


def _check_global(name: str) -> str | None:
    module = name.partition(" ")[0]
    own = module.partition(".")[0] == "__torch__" and not module.startswith("__torch__.torch.classes")
    if own or module == "torch.jit._pickle" or name in GLOBALS:
        return None
    return f"found {name!r:.100}, expected only the file's own classes, and tensors"


def _check_storage(identifier: object, storages: Mapping[str, bytes]) -> str | None:
    match identifier:
        case ("storage", str(kind), str(key), _, int(numbers)) if key in storages:
            size = SIZES.get(kind.removeprefix("torch "), 0)
            if size and 0 <= numbers * size <= len(storages[key]):
                return None
            if size:
                return f"tensor {key}: found {len(storages[key])} bytes, expected {numbers * size}"
    return "found a persistent identifier of another kind, expected a storage of numbers"
