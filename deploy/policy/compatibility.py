"""Whether a policy's contract fits a robot."""

from collections.abc import Iterator

from deploy.policy.contract import Contract, Task
from deploy.policy.observation_terms import READINGS, Term
from robots.errors import ContractError
from robots.spec import RobotSpec


def check_contract(contract: Contract, spec: RobotSpec, source: str) -> None:
    """Compare what a policy assumes with the robot it is to move.

    Raises:
        ContractError: one line for each field: found, expected.
    """
    if wrong := list(mismatches(contract, spec)):
        raise ContractError("\n".join(f"{source}: {line}" for line in wrong))


def mismatches(contract: Contract, spec: RobotSpec) -> Iterator[str]:
    """Each field of a contract that is not as the robot needs it, in a line: found, expected."""
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
    if contract.task != (task := task_of(spec)):
        yield f"task: found {contract.task!r}, expected {task!r}: {spec.name} {_stands(spec)}"
    for term in contract.observation:
        yield from _term(term, contract.action_size, spec)
    if contract.action_size != spec.n:
        yield f"action.size: found {contract.action_size}, expected {spec.n}, one for each joint"


def task_of(spec: RobotSpec) -> Task:
    """What such a robot is asked to do."""
    return "velocity" if spec.base else "reach"


def _stands(spec: RobotSpec) -> str:
    return "has a base" if spec.base else "stands fixed"


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


def _term(term: Term, actions: int, spec: RobotSpec) -> Iterator[str]:
    reading, field = READINGS[term.source], f"observation.{term.name}"
    expected = actions if term.source == "last_action" else reading.size or spec.n
    if term.size != expected:
        yield f"{field}.size: found {term.size}, expected {expected} for {term.source}"
    if reading.stands is not None and reading.stands != (spec.base is None):
        needed = "a robot that stands fixed" if reading.stands else "a base"
        yield f"{field}.source: {term.source} needs {needed}; {spec.name} {_stands(spec)}"
    elif reading.sensor not in spec.sensors:
        yield (
            f"{field}.source: {term.source} needs a sensor of kind {reading.sensor}; {spec.name} has"
            f" {', '.join(spec.sensors)}"
        )
