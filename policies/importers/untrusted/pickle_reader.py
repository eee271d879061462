"""Pickles of unknown origin, walked and never run: of whatever one would call or build, a note is made."""

import pickletools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

from robots.errors import ContractError

OPCODES_MAX = 100_000
DICT = "collections OrderedDict"


@dataclass(slots=True, eq=False, repr=False)
class Inert:
    """What a pickle would have made, had it been run.

    Attributes:
        callee: "module name" of what it would have called, or the opcode.
        arguments: what with.
        state: what the result would have been given afterwards.
    """

    callee: object
    arguments: object
    state: object = None


def read_pickle(data: bytes, source: str) -> object:
    """Numbers, text, bytes, tuples, lists and dicts with keys of text as they are; an `Inert` for everything else.

    No class is looked up, nothing is imported, nothing is called: what a pickle can do ends here.

    Raises:
        ContractError: it is no pickle, or a longer one than any that is read here.
    """
    stacks: list[list[object]] = [[]]
    memo: dict[int, object] = {}
    try:
        for opcode, argument, _ in islice(pickletools.genops(data), OPCODES_MAX):
            if opcode.name == "STOP":
                return stacks[-1].pop()
            _step(opcode, argument, stacks, memo)
    except Exception as e:  # bytes of unknown origin can fail in any way
        raise ContractError(f"{source}: found no pickle that can be read: a {type(e).__name__}") from e
    raise ContractError(f"{source}: found more than {OPCODES_MAX} steps, expected a pickle of fewer")


def _step(
    opcode: pickletools.OpcodeInfo, argument: object, stacks: list[list[object]], memo: dict[int, object]
) -> None:
    if opcode.name == "MARK":
        stacks.append([])
    elif opcode.name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
        memo[len(memo) if argument is None else int(str(argument))] = stacks[-1][-1]
    elif opcode.name in ("GET", "BINGET", "LONG_BINGET"):
        stacks[-1].append(memo[int(str(argument))])
    else:
        taken = _take(stacks, opcode.stack_before)
        if opcode.stack_after:
            stacks[-1].append(_made(opcode.name, argument, taken))


def _take(stacks: list[list[object]], before: Sequence[object]) -> list[object]:
    """Off the stack what an opcode is given, with all above the last mark where it wants that."""
    marked = pickletools.markobject in before
    above = stacks.pop() if marked else []
    start = len(stacks[-1]) - (before.index(pickletools.markobject) if marked else len(before))
    if start < 0:
        raise IndexError("nothing left on the stack")
    taken = stacks[-1][start:]
    del stacks[-1][start:]
    return taken + above


def _made(name: str, argument: object, taken: list[object]) -> object:
    if name in _MAKERS:
        return _MAKERS[name](taken)
    return Inert(name, taken) if argument is None else argument


def _filled(taken: list[object]) -> object:
    """Keys that are no text are left out: to hash what a stranger nested can take forever."""
    target, *items = taken
    if isinstance(target, dict):
        pairs = zip(items[::2], items[1::2], strict=True)
        target.update((key, value) for key, value in pairs if isinstance(key, str))
    return target


def _extended(taken: list[object]) -> object:
    target, *items = taken
    if isinstance(target, list):
        target.extend(items)
    return target


def _reduced(taken: list[object]) -> object:
    callee, arguments = taken
    return {} if callee == DICT and arguments == () else Inert(callee, arguments)


def _built(taken: list[object]) -> object:
    target, state = taken
    if isinstance(target, Inert):
        target.state = state
    return target


_MAKERS: dict[str, Callable[[list], object]] = {
    "NONE": lambda _: None,
    "NEWTRUE": lambda _: True,
    "NEWFALSE": lambda _: False,
    **dict.fromkeys(("EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"), tuple),
    "EMPTY_DICT": lambda _: {},
    **dict.fromkeys(("SETITEM", "SETITEMS"), _filled),
    "EMPTY_LIST": lambda _: [],
    **dict.fromkeys(("APPEND", "APPENDS"), _extended),
    "ADDITEMS": lambda taken: taken[0],
    "STACK_GLOBAL": " ".join,
    "REDUCE": _reduced,
    "NEWOBJ": lambda taken: Inert(*taken),
    "BUILD": _built,
}
