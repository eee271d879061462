"""The safety checks, one row each, in tables by the record that they read.

To add a check, append a row, here or to a copy of `CHECKS` that is given to `Safety`. A check applies if the robot has
all capabilities in `needs`. A quantity that no record has yet is added to its record in check.py and filled in by
safety.py; a new reason is a row of deploy/reasons.py.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from deploy.reasons import Reason
from deploy.safety.check import UNBOUNDED, Check, Estimate, Limits, Motion, Pose, ToolMotion
from robots.arrays import Floats
from robots.capabilities import required

SPEED_TOLERANCE = 1e-6
"""Relative tolerance on speed: Ruckig meets its limits exactly, up to rounding."""


ACCELERATION_TOLERANCE = 1e-4
"""Relative tolerance on acceleration: that of a state that Ruckig had to move to find a plan."""

TAKEOVER_RATE = 2.5
"""Multiple of the policy's torque rate at which a stop may take over. On arm6 one of 2000 setpoints asks for more."""

GIVES_WAY = 0.5
"""Share of `q_soft_rad` beyond the setpoints' range at which a joint of a robot with a floating base gives way."""


def _motor(field: str) -> Callable[[Limits], Floats]:
    return lambda limits: limits.robot.motor_array(field)


def _soft_min(limits: Limits) -> Floats:
    return limits.robot.joint_array("q_min") + limits.robot.margins.q_soft_rad


def _soft_max(limits: Limits) -> Floats:
    return limits.robot.joint_array("q_max") - limits.robot.margins.q_soft_rad


def _runaway_speed(limits: Limits) -> Floats:
    """Return rad/s (n,) halfway between the limit of setpoints and that of joints."""
    return (1.0 + limits.robot.margins.speed) / 2.0 * limits.robot.joint_array("qd_max")


def _speed_max(limits: Limits) -> Floats:
    return limits.robot.margins.speed * limits.robot.joint_array("qd_max") * (1 + SPEED_TOLERANCE)


def _acceleration_max(limits: Limits) -> Floats:
    return limits.robot.joint_array("qdd_max") * (1 + ACCELERATION_TOLERANCE)


def _torque_max(limits: Limits) -> Floats:
    return np.minimum(limits.torque, UNBOUNDED)


def _torque_change_max(limits: Limits) -> Floats:
    rates = [required(joint.torque_mode).rate_max for joint in limits.robot.joints]
    return np.array(rates) * (TAKEOVER_RATE * limits.robot.dt)


def _tool_speed_max_squared(limits: Limits) -> float:
    return limits.tool_speed**2


ESTIMATE: tuple[Check[Estimate], ...] = (
    Check(
        name="estimated_joint_angle",
        value=lambda estimate: estimate.state.q,
        low=lambda limits: limits.robot.joint_array("q_min"),
        high=lambda limits: limits.robot.joint_array("q_max"),
        reason=Reason.OUTSIDE,
        per_joint=True,
    ),
    Check(
        name="joint_gives_way",
        value=lambda estimate: estimate.q_soon,
        low=lambda limits: _soft_min(limits) - GIVES_WAY * limits.robot.margins.q_soft_rad,
        high=lambda limits: _soft_max(limits) + GIVES_WAY * limits.robot.margins.q_soft_rad,
        reason=Reason.FALLEN,
        needs=frozenset({"floating_base"}),
        per_joint=True,
    ),
    Check(
        name="joint_runs_away",
        value=lambda estimate: estimate.state.qd,
        low=lambda limits: -_runaway_speed(limits),
        high=_runaway_speed,
        reason=Reason.FALLEN,
        needs=frozenset({"floating_base"}),
        per_joint=True,
    ),
    Check(
        name="self_collision_ahead",  # soft drives let links meet although setpoints keep them apart
        value=lambda estimate: estimate.kinematics_ahead.colliding[:, None],
        low=0.0,
        high=0.0,
        reason=Reason.FALLEN,
        needs=frozenset({"floating_base", "self_collision"}),
    ),
    Check(
        name="estimated_joint_speed",  # only that it is finite: the setpoint's speed is what has a limit
        value=lambda estimate: estimate.state.qd,
        reason=Reason.NOT_FINITE,
        per_joint=True,
    ),
    Check(
        name="tracking_error",
        value=lambda estimate: estimate.sent.q - estimate.state.q,
        low=lambda limits: -limits.robot.margins.tracking_rad,
        high=lambda limits: limits.robot.margins.tracking_rad,
        reason=Reason.TRACKING,
        per_joint=True,
    ),
    Check(
        name="housing_temperature",
        value=lambda estimate: estimate.state.housing_c,
        high=_motor("housing_max_c"),
        reason=Reason.HEAT,
        reason_not_finite=Reason.HEAT,
        per_joint=True,
    ),
    Check(
        name="winding_temperature",
        value=lambda estimate: estimate.state.hottest_c,
        high=_motor("winding_max_c"),
        reason=Reason.HEAT,
        reason_not_finite=Reason.HEAT,
        per_joint=True,
    ),
    # Ages are whole ticks but for rounding: half a tick more, so that an age equal to the limit passes.
    Check(
        name="stale_samples",
        value=lambda estimate: estimate.state.age[:, None],
        high=lambda limits: limits.robot.margins.stale_s + limits.robot.dt / 2,
        reason=Reason.STALE,
        reason_not_finite=Reason.STALE,
    ),
    Check(
        name="lost_samples",
        value=lambda estimate: estimate.state.age[:, None],
        high=lambda limits: limits.robot.margins.lost_s + limits.robot.dt / 2,
        reason=Reason.LOST,
        reason_not_finite=Reason.LOST,
    ),
    Check(
        name="base_tilt",
        value=lambda estimate: -required(estimate.state.base).gravity[:, 2:],
        low=lambda limits: np.cos(required(limits.robot.base).tilt_max_rad),
        reason=Reason.FALLEN,
        needs=frozenset({"floating_base"}),
    ),
    Check(
        name="base_height",
        value=lambda estimate: required(estimate.state.base).height[:, None],
        low=lambda limits: required(limits.robot.base).height_min_m,
        high=np.inf,  # without packets it is not known, which other checks refuse
        reason=Reason.FALLEN,
        needs=frozenset({"floating_base"}),
    ),
    Check(
        name="base_descent",
        value=lambda estimate: -required(estimate.state.base).velocity_in_world[:, 2:],
        high=lambda limits: required(limits.robot.base).descent_max,
        reason=Reason.FALLEN,
        needs=frozenset({"floating_base"}),
    ),
)
"""Checks of the estimate."""

MOTION: tuple[Check[Motion], ...] = (
    Check(
        name="joint_angle",
        value=lambda motion: motion.q,
        low=_soft_min,
        high=_soft_max,
        reason=Reason.POSITION,
        per_joint=True,
    ),
    Check(
        name="joint_speed",
        value=lambda motion: motion.qd,
        low=lambda limits: -_speed_max(limits),
        high=_speed_max,
        reason=Reason.VELOCITY,
        per_joint=True,
    ),
    Check(
        name="joint_peak_speed",
        value=lambda motion: motion.qd_peak,
        low=lambda limits: -_speed_max(limits),
        high=_speed_max,
        reason=Reason.VELOCITY,
        per_joint=True,
    ),
    Check(
        name="joint_acceleration",
        value=lambda motion: motion.qdd,
        low=lambda limits: -_acceleration_max(limits),
        high=_acceleration_max,
        reason=Reason.ACCELERATION,
        per_joint=True,
    ),
    Check(
        name="joint_torque",
        value=lambda motion: motion.needed,
        low=lambda limits: -_torque_max(limits),
        high=_torque_max,
        reason=Reason.TORQUE,
        per_joint=True,
    ),
)
"""Checks of a setpoint, and of the stop that would begin there: its first step, and moments while it brakes."""

TAKEOVER: tuple[Check[Motion], ...] = (
    Check(
        name="torque_change_of_stop",
        value=lambda motion: motion.tau_change,
        low=lambda limits: -_torque_change_max(limits),
        high=_torque_change_max,
        reason=Reason.TORQUE,
        per_joint=True,
    ),
)
"""More checks of its first step where the drives of a stop take over from torques."""

TOOL: tuple[Check[ToolMotion], ...] = (
    Check(
        name="tool_speed",
        value=lambda motion: motion.speed_squared,
        high=_tool_speed_max_squared,
        reason=Reason.TOOL_SPEED,
        needs=frozenset({"workspace"}),
    ),
)
"""Checks of the tool's motion at a setpoint and while its stop brakes."""

POSES: tuple[Check[Pose], ...] = (
    Check(
        name="joint_angle_of_pose",
        value=lambda pose: pose.q,
        low=_soft_min,
        high=_soft_max,
        reason=Reason.POSITION,
        per_joint=True,
    ),
    Check(
        name="manipulability",
        value=lambda pose: pose.kinematics.manipulability()[:, None],
        low=lambda limits: required(limits.robot.margins.singularity),
        reason=Reason.SINGULARITY,
        needs=frozenset({"manipulability"}),
    ),
    Check(
        name="self_collision",
        value=lambda pose: pose.kinematics.colliding[:, None],
        low=0.0,
        high=0.0,
        reason=Reason.COLLISION,
        needs=frozenset({"self_collision"}),
    ),
    Check(
        name="tool_height",
        value=lambda pose: pose.kinematics.tool_position[:, 2:],
        low=lambda limits: (
            required(limits.robot.workspace).z_min + required(limits.robot.margins.workspace_m)
        ),
        reason=Reason.WORKSPACE,
        needs=frozenset({"workspace"}),
    ),
    Check(
        name="tool_radius",
        value=lambda pose: pose.tool_radius_squared,
        high=lambda limits: (
            (required(limits.robot.workspace).radius_max - required(limits.robot.margins.workspace_m)) ** 2
        ),
        reason=Reason.WORKSPACE,
        needs=frozenset({"workspace"}),
    ),
)
"""Checks of the poses at a setpoint, while its stop brakes and at its end, without velocities."""


class Checks(NamedTuple):
    """All checks, by the record that they read and the moments at which they are made."""

    estimate: tuple[Check[Estimate], ...] = ESTIMATE
    motion: tuple[Check[Motion], ...] = MOTION
    takeover: tuple[Check[Motion], ...] = TAKEOVER
    tool: tuple[Check[ToolMotion], ...] = TOOL
    poses: tuple[Check[Pose], ...] = POSES


CHECKS = Checks()
