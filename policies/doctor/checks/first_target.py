"""How far, and how fast, the policy's first target is from where the robot stands."""

from collections.abc import Iterator

import numpy as np

from policies.doctor.check_context import Case
from policies.doctor.check_result import Note, failed, listed, passed, warned
from robots.models.nominal_model import torque_max

FAR = 0.5
"""rad. A robot that is sent farther at once is not where its policy takes it to be."""


def activation(case: Case) -> Iterator[Note]:
    """From the home pose at rest, the worst of some goals."""
    if case.contract.action.gains:
        yield from _pull(case)
        return
    spec, life = case.spec, case.life
    jump = np.abs(life.first).max(axis=0)
    names, qd_max = spec.joint_names, spec.joint_array("qd_max")
    q = spec.joint_array("q_home") + life.first
    outside = ((q < spec.joint_array("q_min")) | (q > spec.joint_array("q_max"))).any(axis=0)
    if (far := (jump > FAR) | outside).any():
        yield failed(
            f"at the first step it sends {listed(names, jump, unit=' rad', which=far)} away from the home pose"
            f"{', beyond the working range' if outside.any() else ''}: the offset or the home pose of robot.toml is not"
            " training's default pose."
        )
    speed = jump * case.contract.policy_hz
    if (fast := (speed > qd_max) & ~far).any():
        yield warned(
            "without the smoother the first step would go at"
            f" {listed(names, speed, qd_max, unit=' rad/s', which=fast)}: begin nearer to the default pose, or ramp in."
        )
    yield passed(
        f"the first target is {listed(names, jump, unit=' rad')} from home; without the smoother"
        f" {speed.max():.2g} rad/s at most."
    )


def _pull(case: Case) -> Iterator[Note]:
    """Of soft drives, which are nowhere near where they are sent: the torque of the first step counts."""
    spec, gains = case.spec, case.contract.action.gains
    tau = np.zeros(spec.n) if gains is None else gains.kp * np.abs(case.life.first).max(axis=0)
    most = torque_max(spec)
    if (far := tau > most).any():
        yield failed(
            f"at the first step it asks for {listed(spec.joint_names, tau, most, unit=' N·m', which=far)}: the offset"
            " or the home pose of robot.toml is not training's default pose."
        )
    yield passed(f"the first step asks for {listed(spec.joint_names, tau, most, unit=' N·m')}.")
