"""Checks of action scale and offset against joint limits and gains."""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import NAMED_MAX, Message, failed, flag, format_values, passed, warned
from robots.arrays import Floats
from robots.models.nominal_model import load_pinocchio, torque_max

SHARE_MIN = 0.02
"""Share of a joint's range or speed; an action of 1 that requests less has almost no effect."""
FACTOR_MAX = 3.0
"""Multiple of a joint's speed or torque; an action of 1 that requests more has a wrong scale, rate or gain."""
DAMPING = (0.05, 20.0)
"""Plausible damping ratios of gains in the units of the contract."""
REQUEST = "an action of 1 asks for "


def action(context: CheckContext) -> Iterator[Message]:
    """Compare scale, offset and clip with the working range and the home pose."""
    spec, spec_of_action = context.spec, context.contract.action
    if spec_of_action.size != spec.n:
        yield failed(f"found {spec_of_action.size} actions for {spec.n} joints: see the joint order.")
        return
    if spec_of_action.clip is None:
        yield warned("clip: none, so only the working range limits the action: set the clip of training.")
    offset = spec_of_action.offset
    yield from _increments(context) if offset is None else _positions(context, np.array(offset))


def _increments(context: CheckContext) -> Iterator[Message]:
    spec, hz = context.spec, context.contract.policy_hz
    low, high = context.contract.action.bounds
    qd, qd_max = np.array(context.contract.action.scale) * hz, spec.joint_array("qd_max")
    requested = min(max(-low, high), 1.0) * qd
    excessive, at = requested > FACTOR_MAX * qd_max, f" at {hz} Hz"
    for note, selection, after in (
        (failed, excessive, f"{at}: scale or rate differ from training."),
        (warned, (requested > qd_max) & ~excessive, f"{at}: compare scale and rate with training."),
        (warned, requested < SHARE_MIN * qd_max, f"{at}, almost nothing: compare the scale with training."),
    ):
        yield from flag(
            note, selection, REQUEST, spec.joint_names, requested, qd_max, unit=" rad/s", after=after
        )
    yield passed(f"{REQUEST}{format_values(spec.joint_names, requested, qd_max, unit=' rad/s')}.")


def _positions(context: CheckContext, offset: Floats) -> Iterator[Message]:
    names, scale = context.spec.joint_names, np.array(context.contract.action.scale)
    q_min, q_max, home = (context.spec.joint_array(f"q_{end}") for end in ("min", "max", "home"))
    outside, span = (offset < q_min) | (offset > q_max), q_max - q_min
    expected = "the offset must be the default pose of training, in the robot's order and in rad."
    after = f", outside the working range: {expected}"
    yield from flag(failed, outside, "an action of 0 asks for ", names, offset, unit=" rad", after=after)
    beyond = ((offset - scale < q_min) | (offset + scale > q_max)) & ~outside
    if beyond.any():
        yield warned(
            f"an action of 1 or -1 sends {', '.join(np.array(names)[beyond][:NAMED_MAX])} beyond the working range,"
            " where the smoother clamps it: compare offset and scale with training."
        )
    for selection, after in (
        (scale < SHARE_MIN * span, ", almost nothing: compare the scale with training."),
        (scale > span, ", more than the joint can: compare the scale."),
    ):
        yield from flag(
            warned, selection, "an action of 1 moves ", names, scale, span, unit=" rad", after=after
        )
    yield passed(f"an action of 0 asks for {format_values(names, offset, home, unit=' rad')}, where home is.")


def gains(context: CheckContext) -> Iterator[Message]:
    """Compare the gains of training with torque and inertia; a contract without gains uses the robot's own."""
    spec_of_action, spec = context.contract.action, context.spec
    if spec_of_action.kp is None or spec_of_action.kd is None:
        if "imported" in context.contract.trained:
            yield warned(
                "none in the contract, so they cannot be compared with training: the drives of"
                f" {spec.name} use their own, which may be stiffer or softer."
            )
        yield passed(f"none in the contract: it was trained with the drives of {spec.name} as they are.")
        return
    if spec_of_action.size != spec.n:
        yield failed(
            f"found gains of {spec_of_action.size} joints, expected {spec.n}, one for each of {spec.name}'s."
        )
        return
    yield from _check_torque_and_damping(context, np.array(spec_of_action.kp), np.array(spec_of_action.kd))


def _check_torque_and_damping(context: CheckContext, kp: Floats, kd: Floats) -> Iterator[Message]:
    """Check the torque of an action of 1 and the damping ratio of the gains."""
    names, limit = context.spec.joint_names, torque_max(context.spec)
    tau = kp * np.array(context.contract.action.scale)
    excessive = tau > FACTOR_MAX * limit
    for note, selection in ((failed, excessive), (warned, (tau > limit) & ~excessive)):
        before, after = (
            "kp × scale, the torque of an action of 1, is ",
            ": compare kp and scale with training.",
        )
        yield from flag(note, selection, before, names, tau, limit, unit=" N·m", after=after)
    ratio = kd / (2.0 * np.sqrt(kp * _inertia(context)))
    odd, usual = (ratio < DAMPING[0]) | (ratio > DAMPING[1]), f"{DAMPING[0]} to {DAMPING[1]}"
    after = f", usual is {usual}: are they of the joint, in N·m/rad and N·m·s/rad?"
    yield from flag(warned, odd, "kp and kd give a damping ratio of ", names, ratio, after=after)
    yield passed(f"{REQUEST}{format_values(names, tau, limit, unit=' N·m')}.")


def _inertia(context: CheckContext) -> Floats:
    """Return the inertia (n,) kg·m² of each joint in the home pose, including rotors."""
    model, _ = load_pinocchio(context.spec)
    mass = pin.crba(model, model.createData(), context.spec.joint_array("q_home"))
    return np.asarray(np.diag(mass))
