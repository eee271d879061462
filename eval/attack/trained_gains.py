"""Drive gains of training that the policies of an attack have in their contracts."""

from pathlib import Path
from typing import NamedTuple

from deploy.policy.policy import Policy
from robots.errors import ConfigError
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec


class TrainedGains(NamedTuple):
    """Stiffness and damping: kp in N·m/rad, kd in N·m·s/rad, of each joint."""

    kp: tuple[float, ...]
    kd: tuple[float, ...]


def gains_of(path: Path, spec: RobotSpec, mode: ControlMode) -> TrainedGains:
    """Return the drive gains of a policy's contract, for a mode of the drives.

    Raises:
        ContractError: the file or its contract does not fit the robot.
        ConfigError: its drives have their own gains, or follow it in another mode.
    """
    action = Policy.load(path, spec).contract.action
    if action.kp is None or action.kd is None:
        raise ConfigError(f"--gains: {path}: found no kp and kd in its contract, expected some")
    if action.control_mode is not mode:
        raise ConfigError(f"--gains: {path}: found mode {action.mode!r}, expected that of --mode")
    return TrainedGains(action.kp, action.kd)
