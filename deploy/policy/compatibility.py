"""Compatibility of a policy's contract with a robot, and the sensors that both read together."""

import math
from collections.abc import Iterator

from deploy.estimation.capabilities import ESTIMATORS
from deploy.estimation.estimator import Estimator
from deploy.policy.contract import Contract
from deploy.policy.contract_action import MODES, ActionSpec
from deploy.policy.contract_term import Term
from deploy.policy.gain_bounds import gain_misfits
from deploy.sources.source import ObservationSource
from deploy.tasks.task import find_task, sources_of
from robots.errors import ContractError
from robots.motors.control_mode import ControlMode
from robots.sensors import Kind
from robots.spec import RobotSpec


def check_contract(contract: Contract, spec: RobotSpec, source: str) -> None:
    """Compare the assumptions of a policy with the robot that it is to move.

    Raises:
        ContractError: one line for each field: found, expected.
    """
    if wrong := list(mismatches(contract, spec)):
        raise ContractError("\n".join(f"{source}: {line}" for line in wrong))


def mismatches(contract: Contract, spec: RobotSpec) -> Iterator[str]:
    """Yield one line for each field of a contract that does not fit the robot: found, expected."""
    if contract.robot != spec.name:
        yield f"robot: found {contract.robot!r}, expected {spec.name!r}"
        return  # nothing else can be expected to agree
    yield from _joints(contract.joint_names, spec)
    if contract.robot_digest != spec.digest:
        yield (
            f"robot_digest: found {contract.robot_digest}, expected {spec.digest} of {spec.folder}: that has changed"
            " since the policy was exported or imported: do it again"
        )
    if contract.control_hz != spec.rates.control_hz:
        yield f"control_hz: found {contract.control_hz} Hz, expected {spec.rates.control_hz} Hz"
    yield from _abilities(contract, spec)
    yield from _free_joints(contract.action, spec)
    yield from gain_misfits(contract.action, spec)
    sources = sources_of(contract.task)
    for term in contract.observation:
        yield from _term(term, sources[term.source], contract.action_size, spec)
        if term.source == "target_offset" and contract.action.control_mode is not ControlMode.POSITION:
            yield (
                f"observation.{term.name}.source: target_offset is a difference of angles, expected none with"
                f" action.mode {contract.action.mode!r}"
            )
    if contract.action_size != spec.n:
        yield f"action.size: found {contract.action_size}, expected {spec.n}, one for each joint"


def sensors_read(contract: Contract, spec: RobotSpec) -> frozenset[Kind]:
    """Return the robot's sensors that an estimator or a term of the contract reads."""
    stages = [stage.sensors for stage in ESTIMATORS if stage.capability in spec.capabilities]
    sources = sources_of(contract.task)
    terms = [sources[term.source].sensors for term in contract.observation]
    read = {kind for kinds in (Estimator.sensors, *stages, *terms) for kind in kinds}
    return frozenset(kind for kind in spec.sensors if kind in read)


def _abilities(contract: Contract, spec: RobotSpec) -> Iterator[str]:
    if misfit := task_misfit(contract.task, spec):
        yield f"task: {misfit}"
    if misfit := mode_misfit(contract.action.mode, spec):
        yield f"action.mode: {misfit}"


def task_misfit(name: str, spec: RobotSpec) -> str:
    """Return why a robot cannot do a task: found, expected; empty if it can."""
    task = find_task(name, f"task: found {name!r}")
    if missing := task.needs - spec.capabilities:
        return f"found {name!r}, which needs {_listed(tuple(sorted(missing)))}; {_has(spec)}"
    misfit = task.misfit(spec)
    return misfit and f"found {name!r}, which {misfit}"


def mode_misfit(mode: str, spec: RobotSpec) -> str:
    """Return why the drives of a robot cannot do the mode of an action: found, expected; empty if they can."""
    if MODES[mode] in spec.control_modes:
        return ""
    known = ", ".join(mode.name.lower() for mode in spec.control_modes)
    return f"found {mode!r}; the drives of {spec.name} have the modes {known}"


def _has(spec: RobotSpec) -> str:
    return f"{spec.name} has {', '.join(sorted(spec.capabilities)) or 'none of the optional capabilities'}"


def _free_joints(action: ActionSpec, spec: RobotSpec) -> Iterator[str]:
    free = [joint for joint, kp in zip(spec.joints, action.kp or (), strict=False) if kp == 0.0]
    if free and spec.base is not None:
        yield "action.kp: found 0, expected above 0 on a robot with a base: a joint that holds no angle carries nothing"
    for joint in free:
        if joint.torque_mode is None:
            yield f"action.kp: found 0, expected above 0: joints.{joint.name} of {spec.name} has no torque_mode"
        if math.isfinite(joint.q_max):
            yield f"action.kp: found 0, expected above 0: joints.{joint.name} of {spec.name} has ends, unlike a wheel"


def _joints(found: tuple[str, ...], spec: RobotSpec) -> Iterator[str]:
    if found == spec.joint_names:
        return
    permuted = sorted(found) == sorted(spec.joint_names)
    what = "the right joints in another order: " if permuted else ""
    yield f"joint_names: {what}found {_listed(found)}, expected {_listed(spec.joint_names)}"


def _listed(names: tuple[str, ...]) -> str:
    return (
        f"[{', '.join(names)}]"
        if len(names) < 100 and all(map(str.isprintable, names))
        else repr(names)[:400]
    )


def _term(term: Term, source: ObservationSource, actions: int, spec: RobotSpec) -> Iterator[str]:
    field = f"observation.{term.name}"
    missing = source.missing(spec)
    if missing:
        yield f"{field}.source: {term.source} needs {missing}"
    if source.needs <= spec.capabilities:
        of_term = {"last_action": actions, "gait_phase": 2 * len(term.phase_offsets)}
        expected = of_term.get(term.source, source.count(spec))
        if term.size != expected:
            yield f"{field}.size: found {term.size}, expected {expected} for {term.source}"
