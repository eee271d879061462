"""Drive gains that the policies of an attack have in their contracts: those of another policy, or at their bounds."""

from pathlib import Path
from typing import NamedTuple

from deploy.policy.gain_bounds import damping_bounds, stiffness_bounds
from deploy.policy.policy import Policy
from deploy.policy.tried_policy import read_tried_policy
from robots.errors import ConfigError
from robots.files import is_missing
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

EXTREMES = ("softest", "stiffest")
"""Names of gains at the bounds of what a contract may have."""
STIFFEST = 0.99
"""Share of the highest stiffness, at which a single damping is allowed."""


class TrainedGains(NamedTuple):
    """Stiffness and damping: kp in N·m/rad, kd in N·m·s/rad, of each joint."""

    kp: tuple[float, ...]
    kd: tuple[float, ...]


def find_gains(name: str, spec: RobotSpec, mode: ControlMode) -> TrainedGains:
    """Return the drive gains of an option: "softest", "stiffest", or those in the contract of a policy file.

    Raises:
        ContractError: the file or its contract does not fit the robot.
        ConfigError: its drives have their own gains, or follow it in another mode; or contracts may have no gains.
    """
    if name not in EXTREMES:
        return _gains_of_file(Path(name), spec, mode)
    if name not in (extremes := extreme_gains(spec, mode)):
        raise ConfigError(
            f"--gains: found {name!r}, expected none: a contract for {spec.name} in {mode.name.lower()} mode has no"
            " choice"
        )
    return extremes[name]


def _gains_of_file(path: Path, spec: RobotSpec, mode: ControlMode) -> TrainedGains:
    if is_missing(path):
        raise ConfigError(
            f"--gains: found '{path!s:.200}', expected softest, stiffest or the file of a policy"
        )
    action = Policy.verified(read_tried_policy(path), f"--gains: {path}", spec).contract.action
    if action.kp is None or action.kd is None:
        raise ConfigError(f"--gains: {path}: found no kp and kd in its contract, expected some")
    if action.control_mode is not mode:
        raise ConfigError(f"--gains: {path}: found mode {action.mode!r}, expected that of --mode")
    return TrainedGains(action.kp, action.kd)


def extreme_gains(spec: RobotSpec, mode: ControlMode) -> dict[str, TrainedGains]:
    """Return the `EXTREMES` of what a contract may have; none in torque mode, or if it has no choice."""
    soft, high = stiffness_bounds(spec, mode)
    stiff = STIFFEST * high
    if mode is ControlMode.TORQUE or (soft >= stiff).any():
        return {}
    damping = damping_bounds(spec, mode, soft).low, damping_bounds(spec, mode, stiff).high
    pairs = zip(EXTREMES, (soft, stiff), damping, strict=True)
    return {name: TrainedGains(tuple(kp.tolist()), tuple(kd.tolist())) for name, kp, kd in pairs}
