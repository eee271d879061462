"""Nominal windings of a robot's motors, from the drives of robot.toml or of the model."""

from typing import NamedTuple

import numpy as np

from robots.arrays import Floats
from robots.errors import RobotError
from robots.motors.dcmotors import Attributes, dcmotors, numbers
from robots.spec import RobotSpec
from robots.tables import Drive


class Windings(NamedTuple):
    """One number for each joint's motor (n,).

    Attributes:
        resistance: ohm at `reference_c`. alpha: 1/K. reference_c: °C.
        to_housing: K/W. capacity: J/K.
        constant: N·m/A at the joint, gear included.
    """

    resistance: Floats
    alpha: Floats
    reference_c: Floats
    to_housing: Floats
    capacity: Floats
    constant: Floats


def nominal_windings(spec: RobotSpec) -> Windings:
    """Read the windings in the order of the joints, from the drives of robot.toml, or from those of the model.

    Raises:
        RobotError: a joint has no `dcmotor`, or one whose `resistance`, `motorconst` or `thermal` is missing or
            impossible.
    """
    if spec.drives:
        return Windings(*np.array([_declared(drive) for drive in spec.drives]).T)
    motors = dcmotors(spec)
    return Windings(*np.array([_winding(spec, name, motors) for name in spec.joint_names]).T)


def _declared(drive: Drive) -> tuple[float, ...]:
    return (
        drive.resistance_ohm,
        drive.copper_per_k,
        drive.reference_c,
        drive.winding_resistance_k_per_w,
        drive.winding_capacity_j_per_k,
        drive.torque_constant * drive.gear,
    )


def _winding(spec: RobotSpec, joint: str, motors: dict[str, Attributes]) -> tuple[float, ...]:
    if joint not in motors:
        raise RobotError(f"{spec.model_path}: actuator: no dcmotor on joint {joint!r}")
    where = f"{spec.model_path}: actuator: dcmotor of joint {joint!r}"
    resistance = numbers(motors[joint], "resistance", 1, where)[0]
    to_housing, capacity, constant, alpha, reference_c, _ = numbers(motors[joint], "thermal", 6, where)
    # Two of the first three are given; of all three the capacity is not read. Source: MuJoCo, XML reference.
    if constant > 0 and to_housing > 0:
        capacity = constant / to_housing
    elif constant > 0 and capacity > 0:
        to_housing = constant / capacity
    if not (resistance > 0 and to_housing > 0 and capacity > 0 and alpha >= 0):
        raise RobotError(
            f"{where}: found resistance {resistance:g} ohm, thermal {motors[joint]['thermal']!r}, expected a resistance"
            " and two of K/W, J/K and s above 0, and a coefficient of at least 0 /K"
        )
    return resistance, alpha, reference_c, to_housing, capacity, _constant(motors[joint], where)


def _constant(motor: Attributes, where: str) -> float:
    """Return N·m/A at the joint. MuJoCo takes the geometric mean of the constants of torque and voltage."""
    torque, volts = numbers(motor, "motorconst", 2, where)
    constant = float(np.sqrt(torque * volts)) if torque > 0 and volts > 0 else max(torque, volts)
    gear, *_ = numbers({"gear": "1"} | motor, "gear", 6, where)
    if not (torque >= 0 and volts >= 0 and constant > 0 and gear != 0):
        raise RobotError(
            f"{where}: found motorconst {motor['motorconst']!r} and gear {gear:g}, expected constants of at least 0"
            " N·m/A, one of them above 0, and a gear that is not 0"
        )
    return constant * gear
