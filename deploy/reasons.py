"""Reasons to refuse a setpoint or to stop a robot: bit, stop category and text of each.

To add a reason, add its bit and its row.
"""

from enum import IntFlag
from functools import reduce
from operator import or_
from typing import Literal, NamedTuple


class Reason(IntFlag):
    """Reasons to refuse a setpoint or to stop a robot, one bit each; several may hold."""

    NONE = 0
    POSITION = 1 << 0
    VELOCITY = 1 << 1
    TORQUE = 1 << 2
    WORKSPACE = 1 << 3
    COLLISION = 1 << 4
    SINGULARITY = 1 << 5
    TOOL_SPEED = 1 << 6
    HEAT = 1 << 7
    STALE = 1 << 8
    LOST = 1 << 9
    TRACKING = 1 << 10
    NOT_FINITE = 1 << 11
    OVERRUN = 1 << 12
    OPERATOR = 1 << 13
    OUTSIDE = 1 << 14
    STUCK = 1 << 15
    DIVERGED = 1 << 16
    MOVING = 1 << 17
    LOAD = 1 << 18
    FALLEN = 1 << 19
    ACCELERATION = 1 << 20
    REPEATED = 1 << 21
    OSCILLATION = 1 << 22


class StopReason(NamedTuple):
    """Stop category (IEC 60204-1) of a reason, and its text for operators.

    Category 2: a controlled stop, power kept; the robot goes on by itself when the cause is gone. Category 1: a
    controlled stop, then power is cut; only an operator's arming clears it. Category 0: power is cut at once, which
    only arming clears, too. If several apply, the lowest number wins.
    """

    category: Literal[0, 1, 2]
    text: str


REASONS = {
    Reason.POSITION: StopReason(2, "a joint would leave its working range"),
    Reason.VELOCITY: StopReason(2, "a joint would exceed its speed limit"),
    Reason.ACCELERATION: StopReason(2, "a joint would exceed its acceleration limit"),
    Reason.TORQUE: StopReason(2, "a joint would need more torque than its drive has"),
    Reason.WORKSPACE: StopReason(2, "the tool would leave its workspace"),
    Reason.COLLISION: StopReason(2, "links would come closer than the collision margin"),
    Reason.SINGULARITY: StopReason(2, "the arm would come too close to a singularity, or pass through it"),
    Reason.TOOL_SPEED: StopReason(2, "the tool would exceed its speed limit"),
    Reason.HEAT: StopReason(1, "a motor is too hot, or its temperature is unknown"),
    Reason.STALE: StopReason(2, "sensor samples are missing"),
    Reason.LOST: StopReason(1, "sensor samples have been missing for too long"),
    Reason.TRACKING: StopReason(1, "a joint does not follow its setpoint"),
    Reason.NOT_FINITE: StopReason(1, "a number is not finite"),
    Reason.OVERRUN: StopReason(1, "too many ticks were late"),
    Reason.OPERATOR: StopReason(1, "stopped by the operator"),
    Reason.OUTSIDE: StopReason(1, "a joint is outside its working range"),
    Reason.STUCK: StopReason(1, "a sensor repeats the same reading"),
    Reason.MOVING: StopReason(2, "a joint moves while the drives are off"),
    Reason.DIVERGED: StopReason(1, "an estimate does not fit the measurements"),
    Reason.LOAD: StopReason(1, "a motor's current does not fit its motion"),
    Reason.OSCILLATION: StopReason(2, "a joint oscillates"),
    Reason.REPEATED: StopReason(1, "too many stops in a short time, without a goal reached"),
    Reason.FALLEN: StopReason(
        0,
        "the robot falls or has fallen: its base tilts too far, is too low or comes down too fast, or a joint gives"
        " way or is too fast",
    ),
}


def _of_category(category: int) -> Reason:
    return reduce(or_, (bit for bit, row in REASONS.items() if row.category == category))


AT_ONCE = _of_category(0)
"""Bits of all reasons of category 0."""
LATCHING = AT_ONCE | _of_category(1)
"""Bits of all reasons that an operator has to clear, of category 0 and 1."""


def describe(reason: int) -> str:
    """Return a bit set of reasons as text."""
    return "; ".join(REASONS[bit].text for bit in Reason(reason)) or "no reason"
