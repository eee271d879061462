"""Bounds of the drive gains in a contract: those that the drives' own loop, the rate of setpoints and the load bear.

Drives close their loop at their own rate, for which `rates.physics_hz` stands: the one at which soaks prove it. A loop
of period T with gains kp and kd on an inertia J is stable while

    kd T / J + kp T² / (2 J) < 2

(symplectic Euler's rule; by Jury's criterion for z² − (2 − kd T / J − kp T² / J) z + 1 − kd T / J). Between two
setpoints the joint must not swing: its natural frequency stays below a quarter of the control rate.
"""

from collections.abc import Iterator

import numpy as np

from deploy.policy.contract_action import ActionSpec
from robots.arrays import Floats
from robots.models.joint_inertia import joint_inertia
from robots.models.nominal_model import torque_max
from robots.spec import RobotSpec

GAIN_MARGIN = 1.5
"""Factor on both gains under which the loop must still be stable: drawn drives have up to 1.2 of theirs."""
SETPOINTS_PER_SWING = 4
"""Control periods in one period of the joint on its drive."""
DAMPING_MIN = 0.05
"""Least damping ratio, on the largest inertia. The least of a known policy is 0.07, at the hip of Unitree's H1."""


def gain_misfits(action: ActionSpec, spec: RobotSpec) -> Iterator[str]:
    """Yield a line for each gain that a joint of the robot cannot bear: field, joint, found, expected."""
    gains = action.gains
    if gains is None or len(gains.kp) != spec.n:
        return
    inertia, period = joint_inertia(spec), 1.0 / spec.rates.physics_hz
    margins = spec.margins.of(action.control_mode)
    load, held = (1.0 - margins.tau) * torque_max(spec), gains.kp > 0.0
    kp_low = np.where(held, load / margins.tracking_rad, 0.0)
    kp_high = inertia.least * (2.0 * np.pi / (SETPOINTS_PER_SWING * spec.dt)) ** 2
    yield from _outside("kp", gains.kp, kp_low, kp_high, spec)
    kp = np.clip(gains.kp, kp_low, kp_high)
    kd_low = np.where(held, 2.0 * DAMPING_MIN * np.sqrt(kp * inertia.most), load / spec.joint_array("qd_max"))
    kd_high = 2.0 * inertia.least / (GAIN_MARGIN * period) - kp * period / 2.0
    yield from _outside("kd", gains.kd, kd_low, kd_high, spec)


def _outside(gain: str, found: Floats, low: Floats, high: Floats, spec: RobotSpec) -> Iterator[str]:
    for joint, value, least, most in zip(spec.joint_names, found, low, high, strict=True):
        if not least <= value <= most:
            yield f"action.{gain}: {joint}: found {value:g}, expected {least:.3g} to {most:.3g}: {_MEANING[gain]}"


_MEANING = {
    "kp": "stiff enough for its load, and no faster than setpoints",
    "kd": "damped, and stable at the rate of its drive",
}
