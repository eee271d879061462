"""Checks of action scale and offset against joint limits and gains."""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import NAMED_MAX, Message, failed, format_values, passed, warned
from robots.arrays import Bools, Floats
from robots.models.nominal_model import load_pinocchio, torque_max

SHARE_MIN = 0.02
"""Share of a joint's range or speed; an action of 1 that requests less has almost no effect."""
FACTOR_MAX = 3.0
"""Multiple of a joint's speed or torque; an action of 1 that requests more has a wrong scale, rate or gain."""
DAMPING = (0.05, 20.0)
"""Plausible damping ratios of gains in the units of the contract."""


def action(context: CheckContext) -> Iterator[Message]:
    """Compare scale, offset and clip with the working range and the home pose."""
    spec, spec_of_action = context.spec, context.contract.action
    if spec_of_action.size != spec.n:
        yield failed(f"found {spec_of_action.size} actions for {spec.n} joints: see the joint order.")
        return
    if spec_of_action.clip is None:
        yield warned("clip: none, so only the working range limits the action: set the clip of training.")
    yield from (
        _increments(context)
        if spec_of_action.offset is None
        else _positions(context, np.array(spec_of_action.offset))
    )


def _increments(context: CheckContext) -> Iterator[Message]:
    spec, spec_of_action = context.spec, context.contract.action
    low, high = spec_of_action.bounds
    qd, qd_max = np.array(spec_of_action.scale) * context.contract.policy_hz, spec.joint_array("qd_max")
    names, requested = spec.joint_names, min(max(-low, high), 1.0) * qd
    if (excessive := requested > FACTOR_MAX * qd_max).any():
        yield failed(
            f"{_describe_request(context, requested, excessive)}: scale or rate differ from training."
        )
    if (fast := (requested > qd_max) & ~excessive).any():
        yield warned(f"{_describe_request(context, requested, fast)}: compare scale and rate with training.")
    if (slow := requested < SHARE_MIN * qd_max).any():
        yield warned(
            f"{_describe_request(context, requested, slow)}, almost nothing: compare the scale with training."
        )
    yield passed(f"an action of 1 asks for {format_values(names, requested, qd_max, unit=' rad/s')}.")


def _describe_request(context: CheckContext, requested: Floats, selection: Bools) -> str:
    names, qd_max = context.spec.joint_names, context.spec.joint_array("qd_max")
    requested_text = format_values(names, requested, qd_max, unit=" rad/s", selection=selection)
    return f"an action of 1 asks for {requested_text} at {context.contract.policy_hz} Hz"


def _positions(context: CheckContext, offset: Floats) -> Iterator[Message]:
    spec, spec_of_action = context.spec, context.contract.action
    names, scale = spec.joint_names, np.array(spec_of_action.scale)
    q_min, q_max, home = (spec.joint_array(f"q_{end}") for end in ("min", "max", "home"))
    outside = (offset < q_min) | (offset > q_max)
    if outside.any():
        yield failed(
            f"an action of 0 asks for {format_values(names, offset, unit=' rad', selection=outside)},"
            " outside the working range:"
            " the offset must be the default pose of training, in the robot's order and in rad."
        )
    beyond = (offset - scale < q_min) | (offset + scale > q_max)
    if (beyond := beyond & ~outside).any():
        yield warned(
            f"an action of 1 or -1 sends {', '.join(np.array(names)[beyond][:NAMED_MAX])} beyond the working range,"
            " where the smoother clamps it: compare offset and scale with training."
        )
    span = q_max - q_min
    if (small := scale < SHARE_MIN * span).any():
        values = format_values(names, scale, span, unit=" rad", selection=small)
        yield warned(f"an action of 1 moves {values}, almost nothing: compare the scale with training.")
    if (wide := scale > span).any():
        values = format_values(names, scale, span, unit=" rad", selection=wide)
        yield warned(f"an action of 1 moves {values}, more than the joint can: compare the scale.")
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
    names, tau, limit = (
        context.spec.joint_names,
        kp * np.array(context.contract.action.scale),
        torque_max(context.spec),
    )
    for note, selection in (
        (failed, tau > FACTOR_MAX * limit),
        (warned, (tau > limit) & (tau <= FACTOR_MAX * limit)),
    ):
        if selection.any():
            yield note(
                "kp × scale, the torque of an action of 1, is"
                f" {format_values(names, tau, limit, unit=' N·m', selection=selection)}:"
                " compare kp and scale with training."
            )
    ratio = kd / (2.0 * np.sqrt(kp * _inertia(context)))
    if (odd := (ratio < DAMPING[0]) | (ratio > DAMPING[1])).any():
        yield warned(
            f"kp and kd give a damping ratio of {format_values(names, ratio, selection=odd)}, usual is"
            f" {DAMPING[0]} to {DAMPING[1]}:"
            " are they of the joint, in N·m/rad and N·m·s/rad?"
        )
    yield passed(f"an action of 1 asks for {format_values(names, tau, limit, unit=' N·m')}.")


def _inertia(context: CheckContext) -> Floats:
    """Return the inertia (n,) kg·m² of each joint in the home pose, including rotors."""
    model, _ = load_pinocchio(context.spec)
    mass = pin.crba(model, model.createData(), context.spec.joint_array("q_home"))
    return np.asarray(np.diag(mass))
