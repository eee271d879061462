"""Monitors of each joint's command: torque rate, jump, speed, acceleration, jerk; add one to `COMMAND_MONITORS`.

Speed, acceleration and jerk are backward differences of the angles sent. On a continuous trajectory each is a mean of
the true derivative, weighted by a B-spline, so that it keeps the limits of the trajectory.
Source: de Boor, A Practical Guide to Splines (1978), ch. IX.
"""

import numpy as np

from eval.judge.monitor import JointMonitor, Monitor, zero_unless
from eval.judge.tick_buffer import PAST
from eval.judge.tick_window import TickWindow
from robots.arrays import Floats

SENT_TOLERANCE = 1e-4
"""Rounding, and the 1e-8 rad/s by which a planner may change its state: 2e-6 of the jerk limit at 200 Hz."""
TAKEOVER_ERRORS = 4.0
"""Multiple of the distance allowed at arming, while drives stiffen: the load carries a joint off that was not held.
Ordinary stops of planar3 and arm6 under random torques have up to 2."""


def _torque_difference(window: TickWindow) -> Floats:
    on = window.drives_on[PAST:] & window.drives_on[PAST - 1 : -1]
    return zero_unless(on, window.now.tau_sent - window.before.tau_sent)


def _jump(window: TickWindow) -> Floats:
    """Distance from the true angle when drives begin to follow angles, and from rest in the second tick of power.

    Drives that followed torques or speeds before take over a moving joint: it is where its speed has brought it. Until
    they have their whole stiffness, each tick is looked at; the distance counts by the share that they have of it.
    """
    holds, on, jump = window.drives_hold, window.drives_on[:, :, None], np.zeros(window.now.q.shape)
    now, before, was_on = holds[PAST:], holds[PAST - 1 : -1], on[PAST - 1 : -1]
    stiffens = now & before & (window.now.stiffness > window.before.stiffness)
    if holds[PAST - 2 :].all() and not stiffens.any():
        return jump
    first = now & ~before & window.before.valid[:, :, None]
    expected = window.before.q + np.where(was_on, window.before.qd * window.robot.spec.dt, 0.0)
    share = np.where(was_on, np.minimum(window.now.stiffness / window.robot.stiffness, 1.0), 1.0)
    allowed = window.robot.limits.arming_rad * np.where(stiffens, TAKEOVER_ERRORS, 1.0)
    missed = np.maximum(share * np.abs(window.now.sent - expected) - allowed, 0.0)
    second = now & before & ~on[PAST - 2 : -2]
    jump[second] = window.sent_differences[0].values[second]
    np.copyto(jump, missed, where=first | stiffens)
    return jump


def _motion_sent(name: str, unit: str, limit: str, order: int, ordinal: str) -> Monitor:
    """Declare the monitor of a difference of the angles sent, 0 where that looks at ticks without power."""
    return JointMonitor(
        name=name,
        unit=unit,
        hard=True,
        meaning=f"{ordinal} backward difference of angles sent",
        limit=lambda robot: robot.spec.joint_array(limit),
        value=lambda window: zero_unless(*window.sent_differences[order - 1]),
        difference_order=order,
        tolerance=SENT_TOLERANCE,
    )


COMMAND_MONITORS = (
    JointMonitor(
        name="torque_rate",
        unit="N·m/s",
        hard=True,
        meaning="1st backward difference of the feed-forward torques sent",
        limit=lambda robot: robot.limits.motor_array("torque_rate", robot.spec),
        value=_torque_difference,
        difference_order=1,
        tolerance=SENT_TOLERANCE,
    ),
    JointMonitor(
        name="command_jump",
        unit="rad",
        hard=True,
        meaning="first angle sent with power, off the true angle by more than arming allows; angle sent to drives that"
        " stiffen, by its share, off by more than a multiple of that; second angle sent, off the first by more than"
        " full acceleration from rest",
        limit=lambda robot: robot.spec.joint_array("qdd_max") * robot.spec.dt**2,
        value=_jump,
        tolerance=SENT_TOLERANCE,
    ),
    _motion_sent("velocity_sent", "rad/s", "qd_max", 1, "1st"),
    _motion_sent("acceleration", "rad/s²", "qdd_max", 2, "2nd"),
    _motion_sent("jerk", "rad/s³", "qddd_max", 3, "3rd"),
)
