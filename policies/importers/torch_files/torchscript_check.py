"""Checks of the source and the pickles in TorchScript files, before torch loads them: some code runs while loading."""

import ast
from collections.abc import Iterable, Iterator, Mapping

from policies.importers.torch_files.operators import is_operator
from policies.importers.untrusted.pickle_reader import PickleRules, read_pickle
from robots.errors import ContractError

TEXT_MAX = 1 << 20
EXPECTED = "expected only operators of policy networks"
REFUSED = frozenset({"from_file", "save", "classes"})
"""Names of methods that take a file name, and of the namespace of foreign C++ classes."""
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
HOOKS = frozenset({"__forward_hooks__", "__forward_pre_hooks__"})
"""Lists of methods that run before and after `forward`, and are not in its graph."""
RUN_AT_LOADING = frozenset({"__setstate__", "__getstate__"})
"""Methods with which a class loads and saves itself."""
PRIM, NAMES = frozenset(_PRIM.split()), frozenset(_NAMES.split())
"""Allowed built-ins of TorchScript. Excluded: fork, rpc_async, print."""
_CONSTRUCTS = (
    "Constant CreateObject DictConstruct GetAttr If ListConstruct Loop SetAttr TupleConstruct TupleSlice"
)
NODES = PRIM | frozenset(_CONSTRUCTS.split())
"""Built-ins and constructs of the language in a compiled graph without calls."""
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


def check_source(text: bytes, source: str) -> None:
    """Refuse code that could access more than tensors. Its run time stays unknown."""
    if len(text) > TEXT_MAX or not all(c == ord("\n") or ord(" ") <= c <= ord("~") for c in text):
        raise ContractError(f"{source}: found no plain text of at most {TEXT_MAX} characters")
    try:
        tree = ast.parse(text.decode("ascii"))
        nodes = list(ast.walk(tree))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as e:
        raise ContractError(f"{source}: found no TorchScript: a {type(e).__name__}") from e
    for line, name in _forbidden(nodes):
        raise ContractError(f"{source}: line {line}: found {name:.100}, {EXPECTED}; nothing of it was run")


def _forbidden(nodes: list[ast.AST]) -> Iterator[tuple[int, str]]:
    inner = {id(node.value) for node in nodes if isinstance(node, ast.Attribute)}
    own = set(_own_names(nodes))
    for node in nodes:
        if isinstance(node, ast.Name):
            if (
                node.id in HOOKS
                or node.id not in own | NAMES
                or (node.id in ("torch", "ops") and id(node) not in inner)
            ):
                yield node.lineno, node.id
        elif isinstance(node, ast.Attribute):
            if not _is_allowed(node, outermost=id(node) not in inner):
                yield node.lineno, ast.unparse(node)
        elif isinstance(node, ast.Constant) and node.value in REFUSED:  # an argument of getattr
            yield node.lineno, repr(node.value)
        elif isinstance(node, ast.FunctionDef) and node.name in RUN_AT_LOADING:
            yield node.lineno, node.name


def _own_names(nodes: list[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name


def _is_allowed(node: ast.Attribute, *, outermost: bool) -> bool:
    match node.value:
        case ast.Name(id="torch"):
            return is_operator(node.attr)
        case ast.Name(id="ops"):
            return node.attr == "prim" and not outermost
        case ast.Attribute(value=ast.Name(id="ops"), attr="prim"):
            return node.attr in PRIM
    return node.attr not in REFUSED


def check_graph(nodes: Iterable[str], source: str) -> None:
    """Refuse a compiled graph with other operators, also those that its source calls as methods of tensors.

    `nodes` are the kinds of its nodes, such as `aten::add`.
    """
    for kind in nodes:
        namespace, _, name = kind.partition("::")
        if not (name in NODES if namespace == "prim" else namespace == "aten" and is_operator(name)):
            raise ContractError(f"{source}: found operator {kind:.100}, {EXPECTED}; nothing of it was run")


def check_pickle(data: bytes, storages: Mapping[str, bytes], source: str) -> None:
    """Refuse classes other than the file's own, and tensors larger than their bytes, which torch does not compare.

    `storages` holds the bytes of the tensors by the names that the pickle gives them.
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
