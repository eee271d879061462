"""Physical maxima by which observations are divided, so that every number of a policy's input has an order of 1."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from robots.arrays import Floats
from robots.models.nominal_model import torque_max
from robots.motors.windings import nominal_windings
from robots.sensors import Kind
from robots.spec import RobotSpec
from robots.tables import Base


class Scale(NamedTuple):
    """Properties that maxima follow from.

    Attributes:
        reach_m: m, largest distance of tool and goals. leash_rad: rad of target ahead of its setpoint.
    """

    spec: RobotSpec
    reach_m: float
    leash_rad: float


class Maximum(NamedTuple):
    """Physical maximum of the numbers of a source.

    Attributes:
        meaning: in words.
        of: one number, one for each joint (n,), or one for each number of a robot.
    """

    meaning: str
    of: Callable[[Scale], Floats | float]


def constant(value: float, meaning: str) -> Maximum:
    """Return a maximum that is the same for every robot."""
    return Maximum(meaning, lambda _: value)


def sensor_range(kind: Kind) -> Maximum:
    """Return the range of a sensor."""
    return Maximum(f"range of the sensor `{kind}`", lambda scale: scale.spec.sensors[kind].range)


def _joint_range(scale: Scale) -> Floats:
    low, high = (np.abs(scale.spec.joint_array(f"q_{end}")) for end in ("min", "max"))
    return np.maximum(low, high)


def _current_max(scale: Scale) -> Floats:
    return torque_max(scale.spec) / nominal_windings(scale.spec).constant


def commands(base: Base | None) -> tuple[Floats, Floats]:
    """Return (3,) the least and the largest command, of a robot with a floating base."""
    if base is None:
        raise RuntimeError("a command range was read of a robot without floating base")
    return np.array(base.command_min), np.array(base.command_max)


def largest_command(scale: Scale) -> Floats:
    """Return (3,) the largest command of each kind, 1 for those that are always 0."""
    largest = np.abs(commands(scale.spec.base)).max(axis=0)
    return np.where(largest > 0.0, largest, 1.0)


def _speed(scale: Scale) -> float:
    x, y, _ = np.abs(commands(scale.spec.base)).max(axis=0)
    return max(1.0, float(np.hypot(x, y)))


UNITY = constant(1.0, "1")
HALF_TURN = constant(np.pi, "π")
JOINT_RANGE = Maximum("end of the working range that is farther from 0", _joint_range)
JOINT_SPEED = Maximum("`qd_max` of the joint", lambda scale: scale.spec.joint_array("qd_max"))
JOINT_TORQUE = Maximum("torque range of the joint", lambda scale: torque_max(scale.spec))
CURRENT = Maximum("current at the torque range of the joint", _current_max)
HOUSING = Maximum("`housing_max_c` of the motor", lambda scale: scale.spec.motor_array("housing_max_c"))
REACH = Maximum("`reach_m` of the recipe", lambda scale: scale.reach_m)
REACH_SQUARED = Maximum("`reach_m`² of the recipe", lambda scale: scale.reach_m**2)
LEASH = Maximum("`leash_rad` of the recipe", lambda scale: scale.leash_rad)
COMMAND = Maximum("largest command of its kind; 1 where that is 0", largest_command)
WALKING_SPEED = Maximum("largest commanded speed, at least 1 m/s", _speed)
