"""Nominal model of a robot in Pinocchio, checked against robot.toml."""

import numpy as np
import pinocchio as pin

from robots.arrays import Floats
from robots.errors import RobotError
from robots.models.inertial import check_contacts, imu_in_base
from robots.models.pinocchio_model import foot_frames, read_pinocchio, tool_frame
from robots.spec import RobotSpec

HINGES = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned")
"""Pinocchio's names of a hinge, by its axis."""


def load_pinocchio(spec: RobotSpec) -> tuple[pin.Model, pin.GeometryModel]:
    """Build model and collision geometry; of a robot with a floating base, in the frame of its root body.

    Raises:
        RobotError: Pinocchio cannot read the file or would leave a part of it out; a joint is no hinge; joints, tool
            or feet are not those of robot.toml.
    """
    model, geometry = read_pinocchio(spec)
    _check_parts(spec, model)
    for joint, low, high in zip(spec.joints, model.lowerPositionLimit, model.upperPositionLimit, strict=True):
        if not low <= joint.q_min < joint.q_max <= high:
            raise RobotError(
                f"{spec.folder / 'robot.toml'}: joints.{joint.name}: working range [{joint.q_min}, {joint.q_max}]"
                f" is not inside the mechanical [{low:.4f}, {high:.4f}] of {spec.model_path.name}"
            )
    return model, geometry


def _check_parts(spec: RobotSpec, model: pin.Model) -> None:
    path = str(spec.model_path)
    found = tuple(model.names[1:])
    if found != spec.joint_names:
        raise RobotError(f"{path}: joints are {found}; robot.toml lists {spec.joint_names}")
    for joint in model.joints[1:]:
        if joint.shortname() not in HINGES:
            raise RobotError(
                f"{path}: joint {model.names[joint.id]!r} is {joint.shortname()}, expected a hinge"
            )
    tool_frame(spec, model)
    foot_frames(spec, model)
    if spec.base:
        imu_in_base(spec, model)
        check_contacts(spec, spec.base, model)


def torque_max(spec: RobotSpec) -> Floats:
    """Return (n,) N·m, each joint's `actuatorfrcrange` in the model, or its drive's where the model has none."""
    limit = np.array(load_pinocchio(spec)[0].upperEffortLimit)
    for joint, drive in enumerate(spec.drives):
        if drive.torque_max is not None and not 0 < limit[joint] < np.inf:
            limit[joint] = drive.torque_max
    if not np.isfinite(limit).all():
        names = [name for name, value in zip(spec.joint_names, limit, strict=True) if not np.isfinite(value)]
        raise RobotError(f"{spec.model_path}: no actuatorfrcrange on joints {', '.join(names)}")
    return limit
