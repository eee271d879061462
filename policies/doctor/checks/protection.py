"""Check that the robot's files define torque limits, self-collision shapes and motor heat."""

from collections.abc import Iterator

import numpy as np

from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Message, failed, format_values, passed
from robots.errors import RobotError
from robots.models.collisions import collision_pairs
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.motors.windings import nominal_windings


def protection(context: CheckContext) -> Iterator[Message]:
    """Check each protection; all that are missing are named."""
    spec, names = context.spec, context.spec.joint_names
    try:
        tau = torque_max(spec)
        yield passed(f"torque: {format_values(names, tau, unit=' N·m')}.")
    except RobotError as e:
        yield failed(f"{e}: without it torque is not limited: give each joint its range.")
    model, geometry = load_pinocchio(spec)
    if pairs := len(collision_pairs(model, geometry)):
        yield passed(f"{pairs} pairs of shapes are checked.")
    else:
        yield failed(
            f"{spec.model_path}: no two shapes that could touch: self-collisions are not detected: give the links"
            " capsules that collide."
        )
    try:
        nominal_windings(spec)
        hottest = float(np.max(spec.motor_array("winding_max_c")))
        yield passed(f"winding temperatures are estimated up to {hottest:g} °C.")
    except RobotError as e:
        yield failed(f"{e}: without it motor temperatures are not estimated.")
