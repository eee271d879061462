"""Check of the JSON of exported programs: torch evaluates parts of it as Python, so only plain words are accepted."""

import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

from policies.importers.torch_files.operators import is_operator
from robots.errors import ContractError
from robots.strict import read_json

TEXT_MAX = 64 << 20
PLAIN_WORD = re.compile(r"\w{0,200}", re.ASCII)
DOTTED_NAME = re.compile(r"[\w.]{0,400}", re.ASCII)
PATHS = frozenset({"target", "parameter_name", "buffer_name", "tensor_constant_name", "fqn"})
SYMBOL = re.compile(
    r"(Symbol\('s\d{1,4}', positive=True, integer=True\)|Integer\(-?\d{1,9}\)|Add|Mul|[(), ])+"
)
OPERATOR = re.compile(
    r"torch\.ops\.aten\.(\w+)\.\w+|_operator\.(add|sub|mul|floordiv|neg|getitem|eq|ge|gt|le|lt)"
)
_ARGUMENTS = (
    "none name expr tensor tensors optional_tensor optional_tensors int ints float floats bool bools string strings"
    " sym_int sym_ints sym_float sym_floats sym_bool sym_bools scalar_type memory_format layout device"
)
ARGUMENTS = frozenset(_ARGUMENTS.split())
LEAF: dict[str, object] = {"type": None, "context": None, "children_spec": []}
ONE_TENSOR = {"type": "builtins.tuple", "context": "null", "children_spec": [LEAF]}
NO_KEYWORDS = {"type": "builtins.dict", "context": "[]", "children_spec": []}
SPECS = {
    "in_spec": json.dumps(
        [1, {"type": "builtins.tuple", "context": "null", "children_spec": [ONE_TENSOR, NO_KEYWORDS]}]
    ),
    "out_spec": json.dumps([1, LEAF]),
}
"""Signature: one tensor in, one tensor out."""


def sanitize_program(text: bytes, source: str) -> bytes:
    """Return the program without metadata and guards; refuse values other than aten operators on tensors."""
    program = _read(text, source)
    _refuse(_sanitize(program), source, "exported program")
    return json.dumps(program).encode()


def check_tensors(text: bytes, payloads: Mapping[str, bytes], source: str) -> None:
    """Refuse tensors that are pickled, missing, or larger than their bytes."""
    _refuse(_invalid_tensors(_read(text, source), payloads), source, "list of tensors")


def _refuse(complaints: Iterator[str], source: str, expected: str) -> None:
    """Raise ContractError for the first complaint, or if the data has another structure than the check expects."""
    try:
        complaint = next(complaints, None)
    except (KeyError, TypeError, AttributeError, RecursionError) as e:
        raise ContractError(f"{source}: found no {expected}: a {type(e).__name__}") from e
    if complaint is not None:
        raise ContractError(f"{source}: {complaint}; nothing of it was run")


def _sanitize(program: Any) -> Iterator[str]:
    """Remove metadata and guards, then yield complaints about all other values."""
    inner = program["graph_module"]
    inner["metadata"], inner["treespec_namedtuple_fields"] = {}, {}
    inner["module_call_graph"] = inner["module_call_graph"][:1]
    program["guards_code"], program["torch_version"] = [], ""
    for node in inner["graph"]["nodes"]:
        node["metadata"] = {}
    for name in program["range_constraints"]:
        if not re.fullmatch(r"s\d{1,4}", name):
            yield f"range_constraints: found {name!r:.100}, expected the size of a batch"
    yield from _unexpected(program, "")


def _read(text: bytes, source: str) -> Any:
    return read_json(text.decode(errors="replace"), source, TEXT_MAX, ContractError)


def _unexpected(part: object, key: str, names: re.Pattern[str] = PLAIN_WORD) -> Iterator[str]:
    """Yield a complaint for each key or value that is not expected there."""
    if isinstance(part, dict):
        for name, value in part.items():
            if not names.fullmatch(name) or (name.startswith("as_") and name[3:] not in ARGUMENTS):
                yield f"{key}: found {name!r:.100}, expected only tensors and numbers"
            yield from _unexpected(value, name, names)
    elif isinstance(part, list):
        for value in part:
            yield from _unexpected(value, key, names)
    elif isinstance(part, str) and (expected := _expected(part, key)):
        yield f"{key}: found {part!r:.100}, expected {expected}"


def _expected(text: str, key: str) -> str | None:
    """Return what is expected instead of `text`; None if `text` is allowed."""
    if key in SPECS:
        return None if text == SPECS[key] else "one tensor of observations and one of actions"
    if key == "expr_str":
        return None if SYMBOL.fullmatch(text) else "the size of a batch"
    if key == "target":
        found = OPERATOR.fullmatch(text)
        # The second group is the name of an operator of Python's.
        return None if found and (found[2] or is_operator(found[1])) else "operators of policy networks"
    if key == "type":
        return None if text == "cpu" else "cpu, as for a program that was exported there"
    return None if (DOTTED_NAME if key in PATHS else PLAIN_WORD).fullmatch(text) else "a plain word"


def _invalid_tensors(listed: Any, payloads: Mapping[str, bytes]) -> Iterator[str]:
    yield from _unexpected(listed, "", names=DOTTED_NAME)
    for name, tensor in listed["config"].items():
        if tensor["use_pickle"] is not False:
            yield f"{name}: found a pickle, expected plain numbers"
        elif (payload := payloads.get(tensor["path_name"])) is None:
            yield f"{name}: found {tensor['path_name']!r}, which is none of the tensors in the file"
        elif math.prod(size["as_int"] for size in tensor["tensor_meta"]["sizes"]) > len(payload):
            yield f"{name}: found {len(payload)} bytes, expected all numbers of its shape"
