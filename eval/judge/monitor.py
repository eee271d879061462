"""Type of a monitor: the value measured, its limit, its meaning, the capabilities it needs. monitors.py lists all."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from numpy.typing import NDArray

from eval.judge.tick_window import JudgedRobot, TickWindow
from robots.arrays import Bools, Floats
from robots.capabilities import Capability
from robots.errors import ConfigError
from robots.motors.control_mode import ControlMode

Part = TypeVar("Part")


@dataclass(frozen=True, slots=True, kw_only=True)
class Monitor:
    """One quantity that must stay within its limit.

    A tick is bad where |value| exceeds the limit, or is NaN.

    Attributes:
        unit: of value and limit; empty for yes or no, 1 for a plain number.
        hard: one event is enough to make the robot's draw a bad one.
        events_per_hour: upper bound in budgets that do not name the monitor; None: none of a hard monitor, any number
            of a soft one.
        meaning: what is compared with what, for the report.
        per_joint: one channel for each joint, not a single one for the robot.
        limit: (n,) or a number; infinite if unknown, and then nothing is judged.
        value: (T, R, n) per joint, else (T, R): the value in every tick of the window. 0 where it cannot be known.
        needs: capabilities without which a robot does not have this monitor.
        mode: control mode of the policies that it judges; None: of all.
        difference_order: order of a backward difference that `value` returns without dividing by dt**order.
        tolerance: share by which the limit may be exceeded, for rounding.
    """

    name: str
    unit: str
    hard: bool
    events_per_hour: float | None = None
    meaning: str
    per_joint: bool = False
    limit: Callable[[JudgedRobot], Floats | float]
    value: Callable[[TickWindow], NDArray[Any]]
    needs: frozenset[Capability] = frozenset()
    mode: ControlMode | None = None
    difference_order: int = 0
    tolerance: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class JointMonitor(Monitor):
    """Monitor of every joint."""

    per_joint: bool = True


def zero_unless(mask: Bools, values: NDArray[Any]) -> NDArray[Any]:
    """Return values (T, R, ...), replaced by 0 where the mask (T, R) does not hold."""
    if mask.all():
        return values
    masked = values.copy()
    masked[~mask] = 0.0
    return masked


def available(part: Part | None) -> Part:
    """Return an optional part of a robot that the monitor's `needs` guarantee.

    Raises:
        ConfigError: the robot lacks it.
    """
    if part is None:
        raise ConfigError(
            "monitor: found a robot without a part that the monitor uses; expected it in `needs`"
        )
    return part
