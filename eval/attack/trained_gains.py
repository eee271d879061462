"""Drive gains of training that the policies of an attack have in their contracts."""

from pathlib import Path
from typing import NamedTuple

from deploy.policy.policy import Policy
from robots.errors import ConfigError
from robots.spec import RobotSpec


class TrainedGains(NamedTuple):
    """Stiffness and damping: kp in N·m/rad, kd in N·m·s/rad, of each joint."""

    kp: tuple[float, ...]
    kd: tuple[float, ...]


def gains_of(path: Path, spec: RobotSpec) -> TrainedGains:
    """Return the drive gains of a policy's contract.

    Raises:
        ContractError: the file or its contract does not fit the robot.
        ConfigError: its drives have their own gains.
    """
    action = Policy.load(path, spec).contract.action
    if action.kp is None or action.kd is None:
        raise ConfigError(f"--gains: {path}: found no kp and kd in its contract, expected some")
    return TrainedGains(action.kp, action.kd)
