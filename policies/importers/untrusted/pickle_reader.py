"""Reader of untrusted pickles: plain values only; no class is imported, called or built.

The one reader for files of torch.save, TorchScript and VecNormalize. A sandbox would have to run the pickle, that is a
stranger's code; this reader interprets its opcodes as data.
"""

import pickletools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

from robots.errors import ContractError

OPCODES_MAX = 100_000
INTEGER_BITS_MAX = 128
"""Generators of numpy have states of that size; a much longer integer is no float, and Python may not print it."""
DICT = "collections OrderedDict"
GLOBALS = frozenset({"GLOBAL", "STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4"})
"""Opcodes that would import something."""


@dataclass(slots=True, eq=False, repr=False)
class UnresolvedCall:
    """A call that the pickle asks for, recorded and not made.

    Attributes:
        callee: "module name" of the function or class, or the name of the opcode.
        arguments: of the call.
        state: set on the result by BUILD, if any.
    """

    callee: object
    arguments: object
    state: object = None


class PickleRules(NamedTuple):
    """Limits of one kind of pickle. Each function returns the complaint, or None if it accepts.

    Attributes:
        check_global: given "module name" of an import; for opcodes other than GLOBAL their own name.
        check_storage: given a persistent identifier, by which torch refers to the numbers of a tensor.
        opcodes_max: length of the pickle.
    """

    check_global: Callable[[str], str | None] = lambda _: None
    check_storage: Callable[[object], str | None] = lambda _: None
    opcodes_max: int = OPCODES_MAX


NO_RULES = PickleRules()


def read_pickle(data: bytes, source: str, rules: PickleRules = NO_RULES) -> object:
    """Return numbers, text, bytes, tuples, lists and dicts with text keys; everything else is an `UnresolvedCall`."""
    stacks: list[list[object]] = [[]]
    memo: dict[int, object] = {}
    try:
        for step, (opcode, argument, _) in enumerate(islice(pickletools.genops(data), rules.opcodes_max)):
            if opcode.name == "STOP":
                return stacks[-1].pop()
            if complaint := _complaint(opcode.name, argument, stacks[-1], step, rules):
                raise ContractError(f"{source}: {complaint}; nothing of it was run")
            _step(opcode, argument, stacks, memo)
    except ContractError:
        raise
    except Exception as e:  # bytes of unknown origin can fail in any way
        raise ContractError(f"{source}: found no pickle that can be read: a {type(e).__name__}") from e
    raise ContractError(f"{source}: found more than {rules.opcodes_max} steps, expected a pickle of fewer")


def _complaint(name: str, argument: object, stack: list[object], step: int, rules: PickleRules) -> str | None:
    if name in GLOBALS:
        return rules.check_global(str(argument) if name == "GLOBAL" else name)
    if isinstance(argument, int) and argument.bit_length() > INTEGER_BITS_MAX:
        return f"found an integer of {argument.bit_length()} bits, expected at most {INTEGER_BITS_MAX}"
    if name == "BINPERSID":
        return rules.check_storage(stack[-1])
    if name in ("BINPUT", "LONG_BINPUT") and int(str(argument)) > step:  # torch would allocate that many
        return f"found memo index {argument} at step {step}, expected at most {step}"
    return None


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
        operands = _pop_operands(stacks, opcode.stack_before)
        if opcode.stack_after:
            stacks[-1].append(_result(opcode.name, argument, operands))


def _pop_operands(stacks: list[list[object]], expected: Sequence[object]) -> list[object]:
    """Pop the operands of an opcode, with everything above the last mark if the opcode takes a mark."""
    marked = pickletools.markobject in expected
    above = stacks.pop() if marked else []
    start = len(stacks[-1]) - (expected.index(pickletools.markobject) if marked else len(expected))
    if start < 0:
        raise IndexError("nothing left on the stack")
    operands = stacks[-1][start:]
    del stacks[-1][start:]
    return operands + above


def _result(name: str, argument: object, operands: list[object]) -> object:
    if name in _RESULTS:
        return _RESULTS[name](operands)
    return UnresolvedCall(name, operands) if argument is None else argument


def _update_dict(operands: list[object]) -> object:
    """Leave out keys other than text: hashing a stranger's nested values can take forever."""
    target, *items = operands
    if isinstance(target, dict):
        pairs = zip(items[::2], items[1::2], strict=True)
        target.update((key, value) for key, value in pairs if isinstance(key, str))
    return target


def _extend_list(operands: list[object]) -> object:
    target, *items = operands
    if isinstance(target, list):
        target.extend(items)
    return target


def _reduce(operands: list[object]) -> object:
    callee, arguments = operands
    return {} if callee == DICT and arguments == () else UnresolvedCall(callee, arguments)


def _build(operands: list[object]) -> object:
    target, state = operands
    if isinstance(target, UnresolvedCall):
        target.state = state
    return target


_RESULTS: dict[str, Callable[[list], object]] = {
    "NONE": lambda _: None,
    "NEWTRUE": lambda _: True,
    "NEWFALSE": lambda _: False,
    **dict.fromkeys(("EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"), tuple),
    "EMPTY_DICT": lambda _: {},
    **dict.fromkeys(("SETITEM", "SETITEMS"), _update_dict),
    "EMPTY_LIST": lambda _: [],
    **dict.fromkeys(("APPEND", "APPENDS"), _extend_list),
    "ADDITEMS": lambda operands: operands[0],
    "STACK_GLOBAL": " ".join,
    "REDUCE": _reduce,
    "NEWOBJ": lambda operands: UnresolvedCall(*operands),
    "BUILD": _build,
}
