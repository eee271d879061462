"""Check of the policy's first target: distance and speed from the home pose."""

from collections.abc import Iterator

import numpy as np

from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Message, failed, flag, format_values, passed, warned
from robots.models.nominal_model import torque_max

FAR = 0.5
"""rad; a larger first step means that the policy assumes another pose."""
WRONG_POSE = "the offset or the home pose of robot.toml is not the default pose of training."


def first_target(context: CheckContext) -> Iterator[Message]:
    """Check the largest first step from the home pose at rest, over several goals."""
    if context.contract.action.gains:
        yield from _check_torque(context)
        return
    spec, run = context.spec, context.run
    jump = np.abs(run.first_step).max(axis=0)
    names, qd_max = spec.joint_names, spec.joint_array("qd_max")
    q = spec.joint_array("q_home") + run.first_step
    outside = ((q < spec.joint_array("q_min")) | (q > spec.joint_array("q_max"))).any(axis=0)
    far, speed = (jump > FAR) | outside, jump * context.contract.policy_hz
    range_text = ", beyond the working range" if outside.any() else ""
    after = f" away from the home pose{range_text}: {WRONG_POSE}"
    yield from flag(failed, far, "at the first step it sends ", names, jump, unit=" rad", after=after)
    before, after = (
        "without the smoother the first step would need ",
        ": start closer to the default pose, or ramp in.",
    )
    fast = (speed > qd_max) & ~far
    yield from flag(warned, fast, before, names, speed, qd_max, unit=" rad/s", after=after)
    yield passed(
        f"the first target is {format_values(names, jump, unit=' rad')} from home; without the smoother"
        f" {speed.max():.2g} rad/s at most."
    )


def _check_torque(context: CheckContext) -> Iterator[Message]:
    """Check the torque of the first step, for compliant drives, which do not follow targets closely."""
    spec, gains = context.spec, context.contract.action.gains
    tau = np.zeros(spec.n) if gains is None else gains.kp * np.abs(context.run.first_step).max(axis=0)
    most, before = torque_max(spec), "the first step asks for "
    yield from flag(
        failed, tau > most, before, spec.joint_names, tau, most, unit=" N·m", after=f": {WRONG_POSE}"
    )
    yield passed(f"{before}{format_values(spec.joint_names, tau, most, unit=' N·m')}.")
