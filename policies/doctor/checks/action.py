"""Checks of action scale and offset against joint limits and gains, and of the first target."""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from deploy.motion.drive_law import drive_law
from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import NAMED_MAX, Message, failed, flag, format_values, passed, warned
from robots.arrays import Bools, Floats
from robots.models.fleet import Fleet
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.motors.control_mode import UNITS, ControlMode
from robots.motors.gains import Gains

SHARE_MIN = 0.02
"""Share of a joint's range or speed; an action of 1 that requests less has almost no effect."""
FACTOR_MAX = 3.0
"""Multiple of a joint's speed or torque; an action of 1 that requests more has a wrong scale, rate or gain."""
DAMPING = (0.05, 20.0)
"""Plausible damping ratios of gains in the units of the contract."""
REQUEST = "an action of 1 asks for "
FAR = 0.5
"""rad; a larger first step means that the policy assumes another pose."""
WRONG_POSE = "the offset or the home pose of robot.toml is not the default pose of training."


def action(context: CheckContext) -> Iterator[Message]:
    """Compare scale, offset and clip with the working range and the home pose."""
    spec, command = context.spec, context.contract.action
    if command.size != spec.n:
        yield failed(f"found {command.size} actions for {spec.n} joints: see the joint order.")
        return
    if command.clip is None:
        yield warned("clip: none, so only the working range limits the action: set the clip of training.")
    if command.offset is not None:
        yield from _positions(context, np.array(command.offset))
    elif command.control_mode is ControlMode.POSITION:
        yield from _increments(context)
    else:
        yield from _speeds_or_torques(context)


def _increments(context: CheckContext) -> Iterator[Message]:
    names, hz = context.spec.joint_names, context.contract.policy_hz
    low, high = context.contract.action.bounds
    qd, qd_max = np.array(context.contract.action.scale) * hz, context.spec.joint_array("qd_max")
    requested = min(max(-low, high), 1.0) * qd
    excessive, at = requested > FACTOR_MAX * qd_max, f" at {hz} Hz"
    for note, selection, after in (
        (failed, excessive, f"{at}: scale or rate differ from training."),
        (warned, (requested > qd_max) & ~excessive, f"{at}: compare scale and rate with training."),
        (warned, requested < SHARE_MIN * qd_max, f"{at}, almost nothing: compare the scale with training."),
    ):
        yield from flag(note, selection, REQUEST, names, requested, qd_max, unit=" rad/s", after=after)
    yield passed(f"{REQUEST}{format_values(names, requested, qd_max, unit=' rad/s')}.")


def _speeds_or_torques(context: CheckContext) -> Iterator[Message]:
    """Compare an action of 1 with the limits of speed, or with the ranges of torque."""
    names, mode = context.spec.joint_names, context.contract.action.control_mode
    limit = context.spec.joint_array("qd_max") if mode is ControlMode.VELOCITY else torque_max(context.spec)
    low, high = context.contract.action.bounds
    requested, unit = np.array(context.contract.action.scale) * min(max(-low, high), 1.0), f" {UNITS[mode]}"
    excessive, after = requested > FACTOR_MAX * limit, ": compare the scale with training."
    for note, selection, text in (
        (failed, excessive, after),
        (warned, (requested > limit) & ~excessive, after),
        (warned, requested < SHARE_MIN * limit, f", almost nothing{after}"),
    ):
        yield from flag(note, selection, REQUEST, names, requested, limit, unit=unit, after=text)
    yield passed(f"{REQUEST}{format_values(names, requested, limit, unit=unit)}.")


def _positions(context: CheckContext, offset: Floats) -> Iterator[Message]:
    names, home = context.spec.joint_names, context.spec.joint_array("q_home")
    yield from _range_of_offset(context, offset)
    scale, (q_min, q_max) = np.array(context.contract.action.scale), context.spec.pose_range
    span = q_max - q_min
    before = "an action of 1 moves "
    for selection, after in (
        (scale < SHARE_MIN * span, ", almost nothing: compare the scale with training."),
        (scale > span, ", more than the joint can: compare the scale."),
    ):
        yield from flag(warned, selection, before, names, scale, span, unit=" rad", after=after)
    yield passed(f"an action of 0 asks for {format_values(names, offset, home, unit=' rad')}, where home is.")


def _range_of_offset(context: CheckContext, offset: Floats) -> Iterator[Message]:
    names, (q_min, q_max) = context.spec.joint_names, _working_range(context)
    scale, outside = np.array(context.contract.action.scale), (offset < q_min) | (offset > q_max)
    expected = "the offset must be the default pose of training, in the robot's order and in rad."
    after = f", outside the working range: {expected}"
    yield from flag(failed, outside, "an action of 0 asks for ", names, offset, unit=" rad", after=after)
    beyond = ((offset - scale < q_min) | (offset + scale > q_max)) & ~outside
    if beyond.any():
        yield warned(
            f"an action of 1 or -1 sends {', '.join(np.array(names)[beyond][:NAMED_MAX])} beyond the working range,"
            " where the smoother clamps it: compare offset and scale with training."
        )


def _working_range(context: CheckContext) -> tuple[Floats, Floats]:
    """(n,) smallest and largest position of each joint, rad."""
    return context.spec.joint_array("q_min"), context.spec.joint_array("q_max")


def gains(context: CheckContext) -> Iterator[Message]:
    """Compare the gains of training with torque and inertia; a contract without gains uses the robot's own."""
    gains, spec = context.contract.action.gains, context.spec
    if gains is None:
        if "imported" in context.contract.trained:
            yield warned(
                "none in the contract, so they cannot be compared with training: the drives of"
                f" {spec.name} use their own, which may be stiffer or softer."
            )
        yield passed(f"none in the contract: it was trained with the drives of {spec.name} as they are.")
    elif (size := context.contract.action.size) != spec.n:
        yield failed(f"found gains of {size} joints, expected {spec.n}, one for each of {spec.name}'s.")
    else:
        yield from _torque_and_damping(context, gains)


def _torque_and_damping(context: CheckContext, gains: Gains) -> Iterator[Message]:
    """Check the torque of an action of 1, if that is an angle, and the damping ratio of the gains."""
    names, limit = context.spec.joint_names, _torque_limit(context, gains)
    tau = gains.kp * np.array(context.contract.action.scale)
    is_angle = context.contract.action.control_mode is ControlMode.POSITION
    excessive, before = (tau > FACTOR_MAX * limit) & is_angle, "kp × scale, the torque of an action of 1, is "
    for note, selection in ((failed, excessive), (warned, (tau > limit) & is_angle & ~excessive)):
        after = ": compare kp and scale with training."
        yield from flag(note, selection, before, names, tau, limit, unit=" N·m", after=after)
    holds = gains.kp > 0.0  # without stiffness nothing oscillates
    ratio = gains.kd / (2.0 * np.sqrt(np.where(holds, gains.kp, 1.0) * _inertia(context)))
    odd, usual = (ratio < DAMPING[0]) | (ratio > DAMPING[1]), f"{DAMPING[0]} to {DAMPING[1]}"
    after = f", usual is {usual}: are they of the joint, in N·m/rad and N·m·s/rad?"
    yield from flag(warned, odd & holds, "kp and kd give a damping ratio of ", names, ratio, after=after)
    if is_angle:
        yield passed(f"{REQUEST}{format_values(names, tau, limit, unit=' N·m')}.")
    else:
        yield passed(f"kd of the contract: {format_values(names, gains.kd, unit=' N·m·s/rad')}.")


def _inertia(context: CheckContext) -> Floats:
    """Return the inertia (n,) kg·m² of each joint in the home pose, including rotors."""
    model, _ = load_pinocchio(context.spec)
    mass = pin.crba(model, model.createData(), context.spec.joint_array("q_home"))
    return np.asarray(np.diag(mass))


def first_target(context: CheckContext) -> Iterator[Message]:
    """Check the largest first step from the home pose at rest, over several goals."""
    command = context.contract.action
    if command.control_mode is not ControlMode.POSITION:
        yield passed("a target speed or torque has no first step: the smoother begins at rest.")
    else:
        yield from _first_step(context) if command.gains is None else _first_torque(context, command.gains)


def _first_step(context: CheckContext) -> Iterator[Message]:
    names, qd_max = context.spec.joint_names, context.spec.joint_array("qd_max")
    jump, outside = np.abs(context.run.first_step).max(axis=0), _leaves_range(context)
    far, speed = (jump > FAR) | outside, jump * context.contract.policy_hz
    range_text = ", beyond the working range" if outside.any() else ""
    before, after = "at the first step it sends ", f" away from the home pose{range_text}: {WRONG_POSE}"
    yield from flag(failed, far, before, names, jump, unit=" rad", after=after)
    before, fast = "without the smoother the first step would need ", (speed > qd_max) & ~far
    after = ": start closer to the default pose, or ramp in."
    yield from flag(warned, fast, before, names, speed, qd_max, unit=" rad/s", after=after)
    fastest = f"without the smoother {speed.max():.2g} rad/s at most"
    yield passed(f"the first target is {format_values(names, jump, unit=' rad')} from home; {fastest}.")


def _leaves_range(context: CheckContext) -> Bools:
    """(n,) True for joints whose first target is outside the working range."""
    q, (q_min, q_max) = context.spec.joint_array("q_home") + context.run.first_step, _working_range(context)
    return np.asarray(((q < q_min) | (q > q_max)).any(axis=0))


def _torque_limit(context: CheckContext, gains: Gains) -> Floats:
    """Return the torque at which drives saturate, N·m (n,)."""
    spec, mode = context.spec, context.contract.action.control_mode
    return drive_law(spec, mode, gains, Fleet(spec, 1)).current_share * torque_max(spec)


def _first_torque(context: CheckContext, gains: Gains) -> Iterator[Message]:
    """Check the torque of the first step, for compliant drives, which do not follow targets closely."""
    names, limit = context.spec.joint_names, _torque_limit(context, gains)
    tau, before = gains.kp * np.abs(context.run.first_step).max(axis=0), "the first step asks for "
    yield from flag(failed, tau > limit, before, names, tau, limit, unit=" N·m", after=f": {WRONG_POSE}")
    yield passed(f"{before}{format_values(names, tau, limit, unit=' N·m')}.")
