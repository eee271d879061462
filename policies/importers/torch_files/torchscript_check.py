"""Check of TorchScript source before torch loads it: some of the code runs while loading."""

import ast
from collections.abc import Iterator
from functools import cache

import torch

from robots.errors import ContractError

TEXT_MAX = 1 << 20
REFUSED = frozenset({"from_file", "save", "classes"})
"""Operators of aten that take a file name, and the namespace of foreign C++ classes. Operators are also methods of
tensors and strings, so methods with these names are refused too."""
_PRIM = (
    "RaiseException NumToTensor Uninitialized abs data device dtype grad id is_cpu is_cuda is_mps is_mkldnn is_nested"
    " is_quantized is_sparse itemsize layout max min name nbytes rangelist requires_grad tolist type unchecked_cast"
    " unchecked_unwrap_optional isinstance TupleIndex TupleUnpack ListUnpack IfThenElse EnumName EnumValue"
)
_NAMES = (
    "torch ops __torch__ __annotations__ CONSTANTS annotate unchecked_cast uninitialized getattr hasattr isinstance"
    " range len int float bool str complex number inf infj nan nanj Tensor List Dict Tuple Optional Union Final Any"
    " NoneType Device Module NamedTuple Interface Enum Exception Stream Generator"
)
PRIM, NAMES = frozenset(_PRIM.split()), frozenset(_NAMES.split())
"""Allowed built-ins of TorchScript. Excluded: fork, rpc_async, print."""


def check_source(text: bytes, source: str) -> None:
    """Refuse code that could access more than tensors. Its run time stays unknown.

    Raises:
        ContractError: naming the line and what it would use.
    """
    if len(text) > TEXT_MAX or not all(c == ord("\n") or ord(" ") <= c <= ord("~") for c in text):
        raise ContractError(f"{source}: found no plain text of at most {TEXT_MAX} characters")
    try:
        tree = ast.parse(text.decode("ascii"))
        nodes = list(ast.walk(tree))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as e:
        raise ContractError(f"{source}: found no TorchScript: a {type(e).__name__}") from e
    for line, name in _forbidden(nodes):
        raise ContractError(
            f"{source}: line {line}: found {name:.100}, expected only arithmetic on tensors; nothing of it was run"
        )


def _forbidden(nodes: list[ast.AST]) -> Iterator[tuple[int, str]]:
    inner = {id(node.value) for node in nodes if isinstance(node, ast.Attribute)}
    own = set(_own_names(nodes))
    for node in nodes:
        if isinstance(node, ast.Name):
            if node.id not in own | NAMES or (node.id in ("torch", "ops") and id(node) not in inner):
                yield node.lineno, node.id
        elif isinstance(node, ast.Attribute):
            if not _is_allowed(node, outermost=id(node) not in inner):
                yield node.lineno, ast.unparse(node)
        elif isinstance(node, ast.Constant) and node.value in REFUSED:  # an argument of getattr
            yield node.lineno, repr(node.value)


def _own_names(nodes: list[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name


def _is_allowed(node: ast.Attribute, *, outermost: bool) -> bool:
    owner = ast.unparse(node.value) if isinstance(node.value, ast.Name | ast.Attribute) else ""
    if owner == "torch":
        return node.attr in _operators()
    if owner == "ops":
        return node.attr == "prim" and not outermost
    if owner == "ops.prim":
        return node.attr in PRIM
    return node.attr not in REFUSED


@cache
def _operators() -> frozenset[str]:
    names = (schema.name.split("::") for schema in torch._C._jit_get_all_schemas())
    return frozenset(name for namespace, name in names if namespace == "aten") - REFUSED
