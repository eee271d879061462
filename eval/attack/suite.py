"""Regression suite: cases that attacks have found, tried again."""

from collections.abc import Iterator
from glob import glob
from pathlib import Path
from typing import NamedTuple

from deploy.policy.compatibility import check_contract
from eval.attack.adversaries import ADVERSARIES
from eval.attack.archive import EXEMPT, Archive
from eval.attack.arena import Outcome, Setting, try_candidate
from eval.attack.candidate import Case, check_weights, read_case
from eval.attack.fault_classes import check_faults
from eval.attack.policy_graph import attack_contract
from eval.judge.monitors import MONITORS
from robots.errors import ConfigError, FirstshiftError
from robots.motors.control_mode import ControlMode
from robots.spec import load_robot

SUITE = Path(__file__).parent / "cases"
OPEN = SUITE / "open"
"""Cases that do lead to a hard event, until its cause is fixed: no part of the suite."""
HARD = frozenset(monitor.name for monitor in MONITORS if monitor.hard) - {*EXEMPT}


class Result(NamedTuple):
    """Outcome of a case.

    Attributes:
        path: of its file.
    """

    path: Path
    case: Case
    outcome: Outcome

    @property
    def events(self) -> tuple[str, ...]:
        """Hard monitors that reported, and "diverged" if a simulation did."""
        found = (name for name in self.outcome.worst if name in HARD and self.worst(name) > 1.0)
        return (*found, *(["diverged"] if self.outcome.diverged.any() else []))

    def worst(self, monitor: str) -> float:
        """Return the highest ratio of a monitor."""
        return float(self.outcome.worst[monitor].max())


def run_suite(folder: Path = SUITE) -> Iterator[Result]:
    """Try every case of a folder, in an order that shares robots.

    Raises:
        ConfigError: there is none, or one of them is no case.
        ContractError: the drives cannot bear the gains of a case.
    """
    cases = {folder / name: read_case(folder / name) for name in sorted(glob("*.json", root_dir=folder))}
    if not cases:
        raise ConfigError(f"{folder}: found no case, expected files *.json of soak-attack")
    for path, case in sorted(cases.items(), key=lambda each: _arena_of(each[1])):
        setting = _setting(path, case)
        yield Result(path, case, try_candidate(setting, case.candidate))


def _setting(path: Path, case: Case) -> Setting:
    try:
        spec = load_robot(case.robot)
    except FirstshiftError as e:
        raise ConfigError(f"{path}: robot: {e}") from e
    mode = ControlMode[case.mode.upper()]
    if mode not in spec.control_modes:
        raise ConfigError(f"{path}: mode: found {case.mode}, in which {spec.name} has no drives")
    check_weights(case.candidate, spec, str(path))
    if case.monitor not in (monitors := [monitor.name for monitor in Archive(spec, mode).monitors]):
        raise ConfigError(f"{path}: monitor: found {case.monitor}, expected one of {', '.join(monitors)}")
    if ADVERSARIES[case.adversary].effect and (case.faults or spec.base is not None):
        found = (
            f"faults {', '.join(case.faults)}" if case.faults else f"{spec.name}, which has a floating base"
        )
        raise ConfigError(
            f"{path}: adversary: found {case.adversary} with {found}, expected a fixed base and no fault"
        )
    check_faults(case.faults, spec, mode, f"{path}: faults")
    check_contract(attack_contract(spec, mode, case.gains), spec, str(path))
    return Setting(robot=spec.folder, mode=mode, faults=case.faults, gains=case.gains, loaded=case.loaded)


def _arena_of(case: Case) -> tuple[object, ...]:
    effect = ADVERSARIES[case.adversary].effect or ""
    return case.robot, case.mode, case.faults, case.gains or (), case.loaded, effect, case.seed
