"""Checks of single nodes that would crash ONNX Runtime, or never end, although their shapes are small."""

import re
from collections.abc import Mapping

from onnx import NodeProto, TensorProto, numpy_helper

from deploy.policy.shape_inference import Tensor
from robots.errors import ContractError

TRAPPED = frozenset({TensorProto.INT32, TensorProto.INT64})
"""Types of elements whose smallest number divided by -1 ends the process with SIGFPE; INT8 and INT16 do not."""
UNSAFE_DIVISORS = (0, -1)
"""Divisors that never work: 0 is an error at run time."""
_TERM = rb"[A-Za-z ]*(?:\.\.\.[A-Za-z ]*)?"
EQUATION = re.compile(rb"%(t)b(?:,%(t)b)*(?:->%(t)b)?" % {b"t": _TERM})
"""Equations of Einsum; ONNX's inference of shapes never ends on some others, such as `....`."""
EQUATION_BYTES_MAX = 1 << 8
"""Length of an equation: ten times as long as attention needs."""
BY_VALUES = frozenset({"RoiAlign"})
"""Operators whose work and memory follow from numbers, not from shapes: RoiAlign has as many samples as a region is
large."""


def check_node(node: NodeProto, known: Mapping[str, Tensor], where: str) -> None:
    """Refuse a node that may crash or never end; `known` has its inputs by name.

    Raises:
        ContractError: names what was found and what is expected.
    """
    if node.op_type in BY_VALUES:
        raise ContractError(f"{where}: expected an operator whose work follows from the shapes of its inputs")
    if node.op_type in ("Div", "Mod"):
        _check_divisor(known[node.input[1]], where)
    if node.op_type == "Einsum":
        for attribute in node.attribute:
            _check_equation(attribute.s, where)


def _check_divisor(divisor: Tensor, where: str) -> None:
    if divisor.kind not in TRAPPED:
        return
    expected = "expected floating point, or a constant divisor without 0 and -1"
    if not divisor.constant or divisor.values is None:
        raise ContractError(
            f"{where}: found integers with a divisor that is not a small constant, {expected}"
        )
    values = numpy_helper.to_array(divisor.values)
    if unsafe := [each for each in UNSAFE_DIVISORS if each in values]:
        raise ContractError(f"{where}: found integers with a divisor of {unsafe[0]}, {expected}")


def _check_equation(found: bytes, where: str) -> None:
    if len(found) > EQUATION_BYTES_MAX:
        raise ContractError(f"{where}: found an equation of {len(found)} bytes, at most {EQUATION_BYTES_MAX}")
    if not EQUATION.fullmatch(found):
        expected = "expected terms of letters, each with at most one '...', such as '...ij,jk->...ik'"
        raise ContractError(f"{where}: equation: found {found.decode(errors='replace')!r:.100}, {expected}")
