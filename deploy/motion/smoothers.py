"""Smoother of each control mode."""

from deploy.motion.drive_modes import DriveModes
from deploy.motion.free_smoother import RollingSmoother, TorqueSmoother
from deploy.motion.smoother import Smoother, VelocitySmoother
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec


def make_smoother(spec: RobotSpec, modes: DriveModes) -> Smoother:
    """Return the smoother of the mode in which drives follow the policy."""
    mode, robots = ControlMode(int(modes.policy.mode[0])), len(modes.policy.mode)
    if mode is ControlMode.TORQUE:
        return TorqueSmoother(spec, modes.policy, modes.stop)
    if modes.free:
        return RollingSmoother(spec, modes.policy, modes.stop)
    stiff = VelocitySmoother if mode is ControlMode.VELOCITY else Smoother
    return stiff(spec, robots, modes.policy)
