"""Checks of the loader's conditions and of the joint names and their order."""

from collections.abc import Iterator
from difflib import get_close_matches

import numpy as np

from deploy.policy.policy import BATCHES
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import NAMED_MAX, Message, failed, format_values, passed, warned
from robots.arrays import Floats
from robots.errors import ContractError

ROBOT = "use the robot of the training, or export again for this one"


def loader(context: CheckContext) -> Iterator[Message]:
    """List everything that the loader refuses, not only the first error."""
    contract, spec = context.contract, context.spec
    if contract.robot != spec.name:
        yield failed(f"robot: found {contract.robot!r}, expected {spec.name!r}: {ROBOT}.")
    elif contract.robot_digest != spec.digest:
        yield failed(
            f"robot_digest: {spec.name} has changed since training ({contract.robot_digest:.12}, now"
            f" {spec.digest:.12}): undo the changes in {spec.folder}, or train or import again."
        )
    for line in context.incompatibilities:
        yield failed(f"{line}.")
    try:
        for batch in BATCHES:
            context.policy.verify(context.file, batch)
    except ContractError as e:
        yield failed(f"{_without_path(context, e)}: the network is not the exported one: export it again.")
    yield passed(f"its golden pairs agree, and its contract fits {spec.name}.")


def _without_path(context: CheckContext, error: ContractError) -> str:
    return str(error).removeprefix(f"{context.path}: ")


def joints(context: CheckContext) -> Iterator[Message]:
    """Check joint names, their order, and the mean position of each joint in training."""
    found, robot = context.contract.joint_names, context.spec.joint_names
    if unknown := [name for name in found if name not in robot]:
        suggestions = "; ".join(_nearest(name, robot) for name in unknown[:NAMED_MAX])
        yield failed(
            f"{len(unknown)} joints are not joints of {context.spec.name}: {suggestions}; expected {', '.join(robot)}."
        )
    if missing := [name for name in robot if name not in found]:
        yield failed(f"the contract lacks {', '.join(missing)}: name every joint of {context.spec.name}.")
    if twice := sorted({name for name in found if found.count(name) > 1}):
        yield failed(f"named more than once: {', '.join(twice)}.")
    if sorted(found) == sorted(robot) and found != robot:
        misplaced = [f"{k}: {name}, not {robot[k]}" for k, name in enumerate(found) if name != robot[k]]
        yield failed(
            f"the right joints in another order ({', '.join(misplaced)}): export it again, or let policy-import"
            " settle the order, which permutes observation and action alike."
        )
    if found == robot:
        yield from _check_training_pose(context)


def _nearest(name: str, known: tuple[str, ...]) -> str:
    near = get_close_matches(name, known, cutoff=0.4)
    return f"{name!r}" + (f", perhaps {' or '.join(near)}" if near else "")


def _check_training_pose(context: CheckContext) -> Iterator[Message]:
    """Compare mean joint positions of training, if known, with the working ranges."""
    names, spec = context.spec.joint_names, context.spec
    if (q := _training_q(context)) is None:
        yield warned(
            "names and order are the robot's; the file has no joint statistics of training, so only the simulation"
            " shows whether the network has this order."
        )
        return
    low, high = spec.joint_array("q_min"), spec.joint_array("q_max")
    for j in np.flatnonzero((q < low) | (q > high))[:NAMED_MAX]:
        fits = [name for name, a, b in zip(names, low, high, strict=True) if a <= q[j] <= b]
        others = f", which fits {' or '.join(fits)}" if fits else ", which fits no joint"
        yield warned(
            f"in training the mean of {names[j]} was {q[j]:.3g} rad, outside its range {low[j]:.3g} to"
            f" {high[j]:.3g}{others}: compare order, offset and unit with training."
        )
    yield passed(
        f"names and order are the robot's; mean in training: {format_values(names, q, unit=' rad')}."
    )


def _training_q(context: CheckContext) -> Floats | None:
    """Return mean joint positions (n,) rad of training, newest frame; None if unknown."""
    start = 0
    for term in context.contract.observation:
        end = start + term.size * term.history
        if term.source == "joint_position" and term.size == context.spec.n and context.training is not None:
            mean = context.training.mean[end - term.size : end]
            return np.asarray(mean * np.array(term.scale) + np.array(term.offset or 0.0))
        start = end
    return None
