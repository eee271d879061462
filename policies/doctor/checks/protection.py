"""Whether the robot's own files hold what guards it: torque, self-collision, heat."""

from collections.abc import Iterator

import numpy as np

from policies.doctor.check_context import Case
from policies.doctor.check_result import Note, failed, listed, passed
from robots.errors import RobotError
from robots.models.collisions import collision_pairs
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.windings import nominal_windings


def protection(case: Case) -> Iterator[Note]:
    """Each guard by itself: all that are missing are named."""
    spec, names = case.spec, case.spec.joint_names
    try:
        tau = torque_max(spec)
        yield passed(f"torque: {listed(names, tau, unit=' N·m')}.")
    except RobotError as e:
        yield failed(f"{e}: without it nothing limits torque: give each joint its range.")
    model, geometry = load_pinocchio(spec)
    if pairs := len(collision_pairs(model, geometry)):
        yield passed(f"{pairs} pairs of shapes are looked at.")
    else:
        yield failed(
            f"{spec.model_path}: no two shapes that could meet: nothing would notice that links touch: give the links"
            " capsules that collide."
        )
    try:
        nominal_windings(spec)
        hottest = float(np.max(spec.motor_array("winding_max_c")))
        yield passed(f"windings are followed up to {hottest:g} °C.")
    except RobotError as e:
        yield failed(f"{e}: without it nobody follows how hot a motor is.")
