"""Monitors of each joint's true state, the policy's target and the estimated angle; add one to `JOINT_MONITORS`."""

import numpy as np

from eval.judge.monitor import JointMonitor, zero_unless
from eval.judge.tick_buffer import PAST
from eval.judge.tick_window import TickWindow
from robots.arrays import Floats
from robots.motors.control_mode import ControlMode

TORQUE_FULL = 0.999
"""Share of the torque range that counts as its end: a drive saturates there and cannot exceed it."""


def _target(window: TickWindow) -> Floats:
    """0 without power, when nobody follows the target."""
    return zero_unless(window.now.powered, window.now.target)


def _target_from_middle(window: TickWindow) -> Floats:
    return zero_unless(window.now.powered, window.now.target - window.robot.q_middle)


def _tracking_error(window: TickWindow) -> Floats:
    return zero_unless(window.drives_on[PAST:], window.now.q - window.now.sent)


def _squared_estimate_error(window: TickWindow) -> Floats:
    """Normalized squared error of the angle. The estimate is for the end of the tick before.

    Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 5.4.
    """
    error = window.now.q_hat - window.before.q
    error *= error
    error /= window.now.q_var
    return zero_unless(np.isfinite(window.now.age) & window.before.valid, error)


JOINT_MONITORS = (
    JointMonitor(
        name="position_requested",
        unit="rad",
        hard=False,
        meaning="the policy's target, before clamping, beyond the working range",
        limit=lambda robot: robot.q_half_range,
        value=_target_from_middle,
        mode=ControlMode.POSITION,
    ),
    JointMonitor(
        name="velocity_requested",
        unit="rad/s",
        hard=False,
        meaning="the policy's target speed, before clamping, beyond the joint's limit",
        limit=lambda robot: robot.spec.joint_array("qd_max"),
        value=_target,
        mode=ControlMode.VELOCITY,
    ),
    JointMonitor(
        name="torque_requested",
        unit="N·m",
        hard=False,
        meaning="the policy's target torque, before clamping, beyond the actuator's range",
        limit=lambda robot: robot.torque_max,
        value=_target,
        mode=ControlMode.TORQUE,
    ),
    JointMonitor(
        name="position_soft",
        unit="rad",
        hard=False,
        meaning="true angle closer to the end of the range than its margin",
        limit=lambda robot: robot.q_half_range - robot.spec.margins.q_soft_rad,
        value=lambda window: window.q_from_middle,
    ),
    JointMonitor(
        name="position_hard",
        unit="rad",
        hard=True,
        meaning="true angle beyond the working range",
        limit=lambda robot: robot.q_half_range,
        value=lambda window: window.q_from_middle,
    ),
    JointMonitor(
        name="velocity",
        unit="rad/s",
        hard=True,
        meaning="true joint speed",
        limit=lambda robot: robot.spec.joint_array("qd_max"),
        value=lambda window: window.now.qd,
    ),
    JointMonitor(
        name="torque",
        unit="N·m",
        hard=True,
        meaning="true actuator torque at the end of its range",
        limit=lambda robot: TORQUE_FULL * robot.torque_max,
        value=lambda window: window.now.tau,
    ),
    JointMonitor(
        name="power",
        unit="W",
        hard=False,
        meaning="true mechanical power of a joint, driving or braking",
        limit=lambda robot: robot.limits.motor_array("power_w", robot.spec),
        value=lambda window: window.joint_power,
    ),
    JointMonitor(
        name="heat_soft",
        unit="°C",
        hard=False,
        meaning="true winding temperature, warning",
        limit=lambda robot: robot.spec.motor_array("winding_soft_c"),
        value=lambda window: window.now.winding_c,
    ),
    JointMonitor(
        name="heat_hard",
        unit="°C",
        hard=True,
        meaning="true winding temperature, damage",
        limit=lambda robot: robot.spec.motor_array("winding_max_c"),
        value=lambda window: window.now.winding_c,
    ),
    JointMonitor(
        name="tracking",
        unit="rad",
        hard=False,
        events_per_hour=0.1,
        meaning="distance of the true angle from the angle sent",
        limit=lambda robot: robot.spec.margins.tracking_rad,
        value=_tracking_error,
    ),
    JointMonitor(
        name="estimate",
        unit="1",
        hard=False,
        meaning="squared error of the estimated angle, in variances of the estimate",
        limit=lambda robot: robot.limits.nees,
        value=_squared_estimate_error,
    ),
)
