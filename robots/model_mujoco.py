"""MuJoCo's model of a robot, from the same model.xml."""

import mujoco
import numpy as np

from robots.errors import RobotError
from robots.spec import RobotSpec

INPUTS = 3
"""Controls of one `dcmotor` with `input="pos vel ff"`: motor angle, motor speed, motor torque."""


def read_mjcf(spec: RobotSpec) -> mujoco.MjSpec:
    """Read model.xml at the robot's physics rate, to compile or to add to.

    Raises:
        RobotError: MuJoCo cannot read it.
    """
    try:
        mjcf = mujoco.MjSpec.from_file(str(spec.model_path))
    except (ValueError, mujoco.FatalError) as e:
        raise _unreadable(spec, e) from e
    mjcf.option.timestep = 1.0 / spec.rates.physics_hz
    return mjcf


def load_mujoco(spec: RobotSpec) -> mujoco.MjModel:
    """Compile model.xml at the robot's physics rate.

    Raises:
        RobotError: MuJoCo cannot read it, or its joints, drives or tool are not those of robot.toml.
    """
    path, mjcf = spec.model_path, read_mjcf(spec)
    try:
        model = mjcf.compile()
    except (ValueError, mujoco.FatalError) as e:
        raise _unreadable(spec, e) from e
    free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    if free.any() != (spec.base is not None):
        raise RobotError(
            f"{path}: found {free.sum()} free joints, expected as many as robot.toml has tables base"
        )
    joints = tuple(model.joint(i).name for i in np.flatnonzero(~free))
    if joints != spec.joint_names:
        raise RobotError(f"{path}: joints are {joints}; robot.toml lists {spec.joint_names}")
    driven = tuple(model.joint(model.actuator(i).trnid[0]).name for i in range(model.nactuator))
    if driven != spec.joint_names or model.nu != INPUTS * spec.n or model.na != spec.n:
        raise RobotError(
            f"{path}: drives move {driven} with {model.nu} controls and {model.na} states; expected one dcmotor"
            f' for each of {spec.joint_names} with input="pos vel ff" and thermal'
        )
    if spec.tool and spec.tool not in {model.site(i).name for i in range(model.nsite)}:
        raise RobotError(f"{path}: no site named {spec.tool!r}, which robot.toml calls the tool")
    return model


def _unreadable(spec: RobotSpec, why: Exception) -> RobotError:
    return RobotError(f"{spec.model_path}: MuJoCo cannot read it: {why!s:.300}")
