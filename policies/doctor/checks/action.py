"""Where actions send the joints, and what gains make of that."""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from policies.doctor.check_context import Case
from policies.doctor.check_result import NAMED_MAX, Note, failed, listed, passed, warned
from robots.arrays import Bools, Floats
from robots.models.nominal_model import load_pinocchio, torque_max

LEAST = 0.02
"""Of a joint's range, or of its speed: an action of 1 that moves it by less hardly moves it."""
MOST = 3.0
"""Times a joint's speed, or its torque: an action of 1 that asks for more has a wrong scale, rate or gain."""
DAMPING = (0.05, 20.0)
"""Damping ratios that gains in the units of the contract come to."""


def action(case: Case) -> Iterator[Note]:
    """Scale, offset and clip against working range and home pose."""
    spec, told = case.spec, case.contract.action
    if told.size != spec.n:
        yield failed(f"found {told.size} actions for {spec.n} joints: see the joint order.")
        return
    if told.clip is None:
        yield warned("clip: nothing bounds an action but the working range: say what training clipped at.")
    yield from _increments(case) if told.offset is None else _positions(case, np.array(told.offset))


def _increments(case: Case) -> Iterator[Note]:
    spec, told = case.spec, case.contract.action
    low, high = told.bounds
    qd, qd_max = np.array(told.scale) * case.contract.policy_hz, spec.joint_array("qd_max")
    names, wanted = spec.joint_names, min(max(-low, high), 1.0) * qd
    if (wild := wanted > MOST * qd_max).any():
        yield failed(f"{_asks(case, wanted, wild)}: the scale or the rate is not training's.")
    if (fast := (wanted > qd_max) & ~wild).any():
        yield warned(f"{_asks(case, wanted, fast)}: compare scale and rate with training's.")
    if (slow := wanted < LEAST * qd_max).any():
        yield warned(f"{_asks(case, wanted, slow)}, next to nothing: compare the scale with training's.")
    yield passed(f"an action of 1 asks for {listed(names, wanted, qd_max, unit=' rad/s')}.")


def _asks(case: Case, wanted: Floats, which: Bools) -> str:
    names, qd_max = case.spec.joint_names, case.spec.joint_array("qd_max")
    asked = listed(names, wanted, qd_max, unit=" rad/s", which=which)
    return f"an action of 1 asks for {asked} at {case.contract.policy_hz} Hz"


def _positions(case: Case, offset: Floats) -> Iterator[Note]:
    spec, told = case.spec, case.contract.action
    names, scale = spec.joint_names, np.array(told.scale)
    q_min, q_max, home = (spec.joint_array(f"q_{end}") for end in ("min", "max", "home"))
    outside = (offset < q_min) | (offset > q_max)
    if outside.any():
        yield failed(
            f"an action of 0 asks for {listed(names, offset, unit=' rad', which=outside)}, outside the working range:"
            " the offset is training's default pose, in the robot's order and in rad."
        )
    beyond = (offset - scale < q_min) | (offset + scale > q_max)
    if (beyond := beyond & ~outside).any():
        yield warned(
            f"an action of 1 or -1 sends {', '.join(np.array(names)[beyond][:NAMED_MAX])} beyond the working range,"
            " where the smoother clamps it: compare offset and scale with training's."
        )
    span = q_max - q_min
    if (small := scale < LEAST * span).any():
        moved = listed(names, scale, span, unit=" rad", which=small)
        yield warned(f"an action of 1 moves {moved}, next to nothing: compare the scale with training's.")
    if (wide := scale > span).any():
        moved = listed(names, scale, span, unit=" rad", which=wide)
        yield warned(f"an action of 1 moves {moved}, more than the joint can: compare the scale.")
    yield passed(f"an action of 0 asks for {listed(names, offset, home, unit=' rad')}, where home is.")


def gains(case: Case) -> Iterator[Note]:
    """Those that training had, against torque and inertia; drives with gains of their own ask for none."""
    told, spec = case.contract.action, case.spec
    if told.kp is None or told.kd is None:
        if "imported" in case.contract.trained:
            yield warned(
                "the contract names none, so that training's cannot be compared: the drives of"
                f" {spec.name} follow with their own, which may be stiffer or softer."
            )
        yield passed(f"none in the contract: it was trained with the drives of {spec.name} as they are.")
        return
    if told.size != spec.n:
        yield failed(f"found gains of {told.size} joints, expected {spec.n}, one for each of {spec.name}'s.")
        return
    yield from _strength(case, np.array(told.kp), np.array(told.kd))


def _strength(case: Case, kp: Floats, kd: Floats) -> Iterator[Note]:
    """Torque that an action of 1 asks for at once, and how joint and gains would swing."""
    names, tau, limit = (
        case.spec.joint_names,
        kp * np.array(case.contract.action.scale),
        torque_max(case.spec),
    )
    for note, which in ((failed, tau > MOST * limit), (warned, (tau > limit) & (tau <= MOST * limit))):
        if which.any():
            yield note(
                f"kp × scale, the torque of an action of 1, is {listed(names, tau, limit, unit=' N·m', which=which)}:"
                " compare kp and scale with training's."
            )
    ratio = kd / (2.0 * np.sqrt(kp * _inertia(case)))
    if (odd := (ratio < DAMPING[0]) | (ratio > DAMPING[1])).any():
        yield warned(
            f"kp and kd damp to a ratio of {listed(names, ratio, which=odd)}, usual is {DAMPING[0]} to {DAMPING[1]}:"
            " are they of the joint, in N·m/rad and N·m·s/rad?"
        )
    yield passed(f"an action of 1 asks for {listed(names, tau, limit, unit=' N·m')}.")


def _inertia(case: Case) -> Floats:
    """(n,) kg·m², of each joint in the home pose, rotors included."""
    model, _ = load_pinocchio(case.spec)
    mass = pin.crba(model, model.createData(), case.spec.joint_array("q_home"))
    return np.asarray(np.diag(mass))
