"""Fault classes of an attack, by name."""

from collections.abc import Sequence

from deploy.policy.compatibility import sensors_read
from eval.attack.policy_graph import attack_contract
from eval.faults.catalogue import catalogue, check_names
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

ALL = "all"


def find_faults(names: Sequence[str], spec: RobotSpec, mode: ControlMode, field: str) -> tuple[str, ...]:
    """Return fault classes by their names, or all those of a robot under adversaries for the name "all".

    Raises:
        ConfigError: there is no such class; it names the `field`.
    """
    if ALL in names:
        return tuple(each.name for each in catalogue(spec, sensors_read(attack_contract(spec, mode), spec)))
    check_faults(names, spec, mode, field)
    return tuple(names)


def check_faults(names: Sequence[str], spec: RobotSpec, mode: ControlMode, field: str) -> None:
    """Check that there are such classes.

    Raises:
        ConfigError: there is none of one name; it names the `field`.
    """
    check_names(names, spec, sensors_read(attack_contract(spec, mode), spec), field)
