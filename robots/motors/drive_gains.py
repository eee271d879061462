"""Gains that the drives of a robot have of their own."""

import numpy as np

from robots.errors import RobotError
from robots.motors.dcmotors import dcmotors, numbers
from robots.motors.gains import Gains
from robots.spec import RobotSpec


def drive_gains(spec: RobotSpec) -> Gains:
    """Return the gains of robot.toml's drives, or of the model's `dcmotor` elements, at the joint.

    A motor's gain acts on an angle that is `gear` times as large, and gives a torque that is `gear` times as small.

    Raises:
        RobotError: a joint has no `dcmotor`, or one whose `controller` makes no sense or has no stiffness.
    """
    if spec.drives:
        return Gains(*np.array([(drive.kp, drive.kd) for drive in spec.drives]).T)
    motors, found = dcmotors(spec), []
    for name in spec.joint_names:
        where = f"{spec.model_path}: actuator: dcmotor of joint {name!r}"
        kp, _, kd, *_ = numbers({"controller": "0"} | motors.get(name, {}), "controller", 6, where)
        if not kp > 0.0:
            raise RobotError(
                f"{where}: controller: found kp {kp:g}, expected above 0: stops hold the joint by its drive's kp"
            )
        gear, *_ = numbers({"gear": "1"} | motors.get(name, {}), "gear", 6, where)
        found.append((kp * gear**2, kd * gear**2))
    return Gains(*np.array(found).T)
