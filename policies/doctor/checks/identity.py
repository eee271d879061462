"""Whether the loader would take the file, and whether joints stand in the robot's order."""

from collections.abc import Iterator
from difflib import get_close_matches

import numpy as np

from deploy.policy.policy import BATCHES
from policies.doctor.check_context import Case
from policies.doctor.check_result import NAMED_MAX, Note, failed, listed, passed, warned
from robots.arrays import Floats
from robots.errors import ContractError

ROBOT = "give the robot that it was trained for, or export it again for this one"


def loader(case: Case) -> Iterator[Note]:
    """All that the loader refuses, not only what it meets first."""
    contract, spec = case.contract, case.spec
    if contract.robot != spec.name:
        yield failed(f"robot: found {contract.robot!r}, expected {spec.name!r}: {ROBOT}.")
    elif contract.robot_digest != spec.digest:
        yield failed(
            f"robot_digest: {spec.name} is not as it was in training ({contract.robot_digest:.12}, now"
            f" {spec.digest:.12}): undo what was changed in {spec.folder}, or train or import again."
        )
    for line in case.misfits:
        yield failed(f"{line}.")
    try:
        for batch in BATCHES:
            case.policy.verify(case.file, batch)
    except ContractError as e:
        yield failed(f"{_without(case, e)}: the network is not the one that was exported: export it again.")
    yield passed(f"its golden pairs agree, and its contract fits {spec.name}.")


def _without(case: Case, error: ContractError) -> str:
    return str(error).removeprefix(f"{case.path}: ")


def joints(case: Case) -> Iterator[Note]:
    """Names, their order, and whether what training saw of each could be that joint's."""
    found, robot = case.contract.joint_names, case.spec.joint_names
    if unknown := [name for name in found if name not in robot]:
        told = "; ".join(_nearest(name, robot) for name in unknown[:NAMED_MAX])
        yield failed(
            f"{len(unknown)} joints are none of {case.spec.name}: {told}; it has {', '.join(robot)}: name them so."
        )
    if missing := [name for name in robot if name not in found]:
        yield failed(f"the contract lacks {', '.join(missing)}: name every joint of {case.spec.name}.")
    if twice := sorted({name for name in found if found.count(name) > 1}):
        yield failed(f"named more than once: {', '.join(twice)}.")
    if sorted(found) == sorted(robot) and found != robot:
        moved = [f"{k}: {name}, not {robot[k]}" for k, name in enumerate(found) if name != robot[k]]
        yield failed(
            f"the right joints in another order ({', '.join(moved)}): export it again, or let policy-import"
            " settle the order, which permutes observation and action alike."
        )
    if found == robot:
        yield from _evidence(case)


def _nearest(name: str, known: tuple[str, ...]) -> str:
    near = get_close_matches(name, known, cutoff=0.4)
    return f"{name!r}" + (f", perhaps {' or '.join(near)}" if near else "")


def _evidence(case: Case) -> Iterator[Note]:
    """Where joints stood in training, by what the file says of its observations."""
    names, spec = case.spec.joint_names, case.spec
    if (q := _training_q(case)) is None:
        yield warned(
            "names and order are the robot's, and nothing in the file says what each joint did in training: whether the"
            " network has them in this order only the trial shows."
        )
        return
    low, high = spec.joint_array("q_min"), spec.joint_array("q_max")
    for j in np.flatnonzero((q < low) | (q > high))[:NAMED_MAX]:
        fits = [name for name, a, b in zip(names, low, high, strict=True) if a <= q[j] <= b]
        others = f", which would suit {' or '.join(fits)}" if fits else ", which suits no joint"
        yield warned(
            f"in training the mean of {names[j]} was {q[j]:.3g} rad, outside its range {low[j]:.3g} to"
            f" {high[j]:.3g}{others}: compare the order, the offset and the unit with training's."
        )
    yield passed(f"names and order are the robot's; mean in training: {listed(names, q, unit=' rad')}.")


def _training_q(case: Case) -> Floats | None:
    """(n,) rad, the mean of a joint_position term's newest frame in training; None: not known."""
    start = 0
    for term in case.contract.observation:
        end = start + term.size * term.history
        if term.source == "joint_position" and term.size == case.spec.n and case.training is not None:
            mean = case.training.mean[end - term.size : end]
            return np.asarray(mean * np.array(term.scale) + np.array(term.offset or 0.0))
        start = end
    return None
