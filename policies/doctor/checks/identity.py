"""Checks of the loader's conditions and of the joint names and their order."""

from collections.abc import Iterator
from difflib import get_close_matches

import numpy as np

from deploy.policy.inference import BATCHES
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import NAMED_MAX, Message, failed, format_values, passed, warned
from robots.errors import ContractError

UNKNOWN = (
    "the file has no joint statistics of training, so only the simulation shows whether the network"
    " has this order"
)
ROBOT = "use the robot of the training, or export again for this one"


def loader(context: CheckContext) -> Iterator[Message]:
    """List everything that the loader refuses, not only the first error."""
    contract, spec = context.contract, context.spec
    if contract.robot != spec.name:
        yield failed(f"robot: found {contract.robot!r}, expected {spec.name!r}: {ROBOT}.")
    elif contract.robot_digest != spec.digest:
        found = f"{spec.name} has changed since training ({contract.robot_digest:.12}, now {spec.digest:.12})"
        yield failed(f"robot_digest: {found}: undo the changes in {spec.folder}, or train or import again.")
    yield from (failed(f"{line}.") for line in context.incompatibilities)
    try:
        for batch in BATCHES:
            context.policy.verify(context.file, batch)
    except ContractError as e:
        found = str(e).removeprefix(f"{context.path}: ")
        yield failed(f"{found}: the network is not the exported one: export it again.")
    yield passed(f"its golden pairs agree, and its contract fits {spec.name}.")


def joints(context: CheckContext) -> Iterator[Message]:
    """Check joint names, their order, and the mean position of each joint in training."""
    found, robot = context.contract.joint_names, context.spec.joint_names
    yield from _names(found, robot, context.spec.name)
    if found == robot:
        yield from _training_pose(context)
    elif sorted(found) == sorted(robot):
        misplaced = [f"{k}: {joint}, not {robot[k]}" for k, joint in enumerate(found) if joint != robot[k]]
        advice = "let policy-import settle the order, which permutes observation and action alike"
        yield failed(
            f"the right joints in another order ({', '.join(misplaced)}): export it again, or {advice}."
        )


def _names(found: tuple[str, ...], robot: tuple[str, ...], name: str) -> Iterator[Message]:
    if unknown := [joint for joint in found if joint not in robot]:
        suggestions = "; ".join(_nearest(joint, robot) for joint in unknown[:NAMED_MAX])
        expected = f"{suggestions}; expected {', '.join(robot)}"
        yield failed(f"{len(unknown)} joints are not joints of {name}: {expected}.")
    if missing := [joint for joint in robot if joint not in found]:
        yield failed(f"the contract lacks {', '.join(missing)}: name every joint of {name}.")
    if twice := sorted({joint for joint in found if found.count(joint) > 1}):
        yield failed(f"named more than once: {', '.join(twice)}.")


def _nearest(name: str, known: tuple[str, ...]) -> str:
    near = get_close_matches(name, known, cutoff=0.4)
    return f"{name!r}" + (f", perhaps {' or '.join(near)}" if near else "")


def _training_pose(context: CheckContext) -> Iterator[Message]:
    """Compare mean joint positions of training, if known, with the working ranges."""
    names, spec, begin = context.spec.joint_names, context.spec, "names and order are the robot's"
    positions = (
        q for term, q in context.training_means if term.source == "joint_position" and q.size == spec.n
    )
    if (q := next(positions, None)) is None:
        yield warned(f"{begin}; {UNKNOWN}.")
        return
    low, high = spec.joint_array("q_min"), spec.joint_array("q_max")
    for j in np.flatnonzero((q < low) | (q > high))[:NAMED_MAX]:
        fits = " or ".join(np.array(names)[(low <= q[j]) & (q[j] <= high)]) or "no joint"
        mean = f"in training the mean of {names[j]} was {q[j]:.3g} rad"
        outside = f"outside its range {low[j]:.3g} to {high[j]:.3g}, which fits {fits}"
        yield warned(f"{mean}, {outside}: compare order, offset and unit with training.")
    yield passed(f"{begin}; mean in training: {format_values(names, q, unit=' rad')}.")
