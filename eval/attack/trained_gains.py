"""Drive gains of training that the policies of an attack have in their contracts."""

from pathlib import Path
from typing import NamedTuple

from deploy.policy.gain_bounds import damping_bounds, stiffness_bounds
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


def extreme_gains(spec: RobotSpec, mode: ControlMode) -> tuple[TrainedGains, ...]:
    """Return the softest and the stiffest gains that a contract may have; none in torque mode or if it has no choice.

    The stiffest have 0.99 of the highest stiffness, at which a single damping is allowed.
    """
    low, high = stiffness_bounds(spec, mode)
    stiffest = 0.99 * high
    if mode is ControlMode.TORQUE or (low >= stiffest).any():
        return ()
    softest_damping, stiffest_damping = (
        damping_bounds(spec, mode, low).low,
        damping_bounds(spec, mode, stiffest).high,
    )
    return (
        TrainedGains(tuple(low.tolist()), tuple(softest_damping.tolist())),
        TrainedGains(tuple(stiffest.tolist()), tuple(stiffest_damping.tolist())),
    )
