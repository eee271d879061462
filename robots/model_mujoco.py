"""MuJoCo's model of a robot, from the same model.xml."""

import mujoco

from robots.errors import RobotError
from robots.spec import RobotSpec

INPUTS = 3
"""Controls of one `dcmotor` with `input="pos vel ff"`: motor angle, motor speed, motor torque."""


def load_mujoco(spec: RobotSpec) -> mujoco.MjModel:
    """Compile model.xml at the robot's physics rate.

    Raises:
        RobotError: MuJoCo cannot read it, or its joints, drives or tool are not those of robot.toml.
    """
    path = spec.model_path
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as e:
        raise RobotError(f"{path}: MuJoCo cannot read it: {e!s:.300}") from e
    joints = tuple(model.joint(i).name for i in range(model.njnt))
    if joints != spec.joint_names:
        raise RobotError(f"{path}: joints are {joints}; robot.toml lists {spec.joint_names}")
    driven = tuple(model.joint(model.actuator(i).trnid[0]).name for i in range(model.nactuator))
    if driven != spec.joint_names or model.nu != INPUTS * spec.n or model.na != spec.n:
        raise RobotError(
            f"{path}: drives move {driven} with {model.nu} controls and {model.na} states; expected one dcmotor"
            f' for each of {spec.joint_names} with input="pos vel ff" and thermal'
        )
    if spec.tool not in {model.site(i).name for i in range(model.nsite)}:
        raise RobotError(f"{path}: no site named {spec.tool!r}, which robot.toml calls the tool")
    model.opt.timestep = 1.0 / spec.rates.physics_hz
    return model
