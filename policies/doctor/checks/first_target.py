"""Check of the policy's first target: distance and speed from the home pose."""

from collections.abc import Iterator

import numpy as np

from policies.doctor.check_context import CheckContext
from policies.doctor.check_result import Message, failed, format_values, passed, warned
from robots.models.nominal_model import torque_max

FAR = 0.5
"""rad; a larger first step means that the policy assumes another pose."""


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
    if (far := (jump > FAR) | outside).any():
        yield failed(
            f"at the first step it sends {format_values(names, jump, unit=' rad', selection=far)} away from"
            " the home pose"
            f"{', beyond the working range' if outside.any() else ''}: the offset or the home pose of robot.toml is not"
            " the default pose of training."
        )
    speed = jump * context.contract.policy_hz
    if (fast := (speed > qd_max) & ~far).any():
        yield warned(
            "without the smoother the first step would need"
            f" {format_values(names, speed, qd_max, unit=' rad/s', selection=fast)}: start closer to the"
            " default pose, or ramp in."
        )
    yield passed(
        f"the first target is {format_values(names, jump, unit=' rad')} from home; without the smoother"
        f" {speed.max():.2g} rad/s at most."
    )


def _check_torque(context: CheckContext) -> Iterator[Message]:
    """Check the torque of the first step, for compliant drives, which do not follow targets closely."""
    spec, gains = context.spec, context.contract.action.gains
    tau = np.zeros(spec.n) if gains is None else gains.kp * np.abs(context.run.first_step).max(axis=0)
    most = torque_max(spec)
    if (far := tau > most).any():
        yield failed(
            "the first step asks for"
            f" {format_values(spec.joint_names, tau, most, unit=' N·m', selection=far)}: the offset"
            " or the home pose of robot.toml is not the default pose of training."
        )
    yield passed(f"the first step asks for {format_values(spec.joint_names, tau, most, unit=' N·m')}.")
