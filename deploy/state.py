"""Records that the stages of a tick hand on, one per arrow, every array (B, ...) with B robots.

Joint vectors (B, n) follow `spec.joint_names`. SI units; temperatures in °C. Records are views of their
stage's buffers and hold until that stage's next step: copy what must outlive the tick. They are named tuples because
some are made on every tick: a frozen dataclass takes three times as long to make.
"""

from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

from robots.arrays import Bools, Floats, Ints
from robots.sensors import Kind


class Packet(NamedTuple):
    """Newest packet of one sensor; it may be late, noisy or a repetition.

    Attributes:
        t: (B,) s on the runtime's clock, when it was measured.
        fresh: (B,) a packet arrived since the last read; if not, `value` repeats the last one.
        value: (B, channels) in the unit of the sensor; NaN where a channel has no reading.
    """

    t: Floats
    fresh: Bools
    value: Floats


Sample = Mapping[Kind, Packet]
"""Newest packets of a robot, by kind of sensor."""


class BaseState(NamedTuple):
    """Estimate of a floating base now, in the frame of its IMU.

    Attributes:
        t: s, now.
        quat_wxyz: (B, 4) base in world, yaw relative to the start.
        angular_velocity: (B, 3) rad/s in the base frame, without bias.
        velocity_in_world: (B, 3) m/s. velocity_in_base: (B, 3) m/s.
        gravity: (B, 3) direction of gravity in the base frame: (0, 0, −1) when upright.
        height: (B,) m, of the IMU above the lowest foot; infinite until it is known.
        age: (B,) s since the newest samples of gyro and accelerometer were measured, the older of the two.
        innovation: (B, F, 3) of the newest sample, whitened by its covariance; 0 for feet that do not stand.
        stuck: (B,) the IMU repeats its samples; they are not used.
        diverged: (B,) the estimate is unreliable: see `BaseFilter`.
    """

    t: float
    quat_wxyz: Floats
    angular_velocity: Floats
    velocity_in_world: Floats
    velocity_in_base: Floats
    gravity: Floats
    height: Floats
    age: Floats
    innovation: Floats
    stuck: Bools
    diverged: Bools


class State(NamedTuple):
    """Estimate of the robots now.

    Attributes:
        t: s, now.
        q: (B, n) rad. qd: (B, n) rad/s.
        q_var: (B, n) rad², variance of `q`.
        age: (B,) s since the newest accepted sample was measured, of the joint with the oldest; infinite until every
            filter is confirmed.
        nis: (B, n) running mean of the normalized innovation squared; near 1 for a consistent filter.
        housing_c: (B, n) °C, motor housing.
        winding_c: (B, n) °C, estimated. hottest_c: (B, n) °C, its upper bound.
        current_share: (B, n) share of its current that a drive may use while running.
        fault: (B,) int64 bit sets of `Reason`, faults of the estimate; 0 for none.
        base: estimate of the floating base; None for robots without one.
    """

    t: float
    q: Floats
    qd: Floats
    q_var: Floats
    age: Floats
    nis: Floats
    housing_c: Floats
    winding_c: Floats
    hottest_c: Floats
    current_share: Floats
    fault: Ints
    base: BaseState | None = None


class DriveMode(NamedTuple):
    """Quantity that drives follow, and how firmly.

    Attributes:
        mode: (B,) of `ControlMode`.
        kp: (B, n) N·m/rad, stiffness: 0 where a drive follows no angle. kd: (B, n) N·m·s/rad, damping.
    """

    mode: Ints
    kp: Floats
    kd: Floats


class Target(NamedTuple):
    """Joint target of the policy, before any limit.

    Attributes:
        drive: how drives are to follow it.
        value: (B, n) rad, rad/s or N·m, as `drive.mode` says; may lie beyond the joints' limits.
        finite: (B,) the policy's action was finite; where it was not, `value` repeats the last target.
    """

    drive: DriveMode
    value: Floats
    finite: Bools


class Setpoint(NamedTuple):
    """Point of a trajectory.

    Attributes:
        q: (B, n) rad. qd: (B, n) rad/s. qdd: (B, n) rad/s². In torque mode they are predicted.
        tau: (B, n) N·m, torque to be sent in torque mode; None where no robot can be in torque mode.
        drive: how drives are to follow it; None of a point that is not to be sent.
    """

    q: Floats
    qd: Floats
    qdd: Floats
    tau: Floats | None = None
    drive: DriveMode | None = None


BRAKING_SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)
"""Moments at which a stop is checked, as shares of the time in which all joints but the slowest brake.

The first is early: the tool gains most speed, and most torque is needed, at the beginning of a stop.
"""
STOP_MOMENTS = len(BRAKING_SHARES)


class Stop(NamedTuple):
    """Stop that would begin at a setpoint.

    Attributes:
        ahead: its first step.
        q, qd, qdd: (STOP_MOMENTS, B, n) rad, rad/s, rad/s², while it brakes.
        q_rest: (B, n) rad, its end.
    """

    ahead: Setpoint
    q: Floats
    qd: Floats
    qdd: Floats
    q_rest: Floats


class Verdict(NamedTuple):
    """Result of the safety checks of one setpoint.

    Attributes:
        reason: (B,) int64 bit sets of `Reason`, 0 if the setpoint may be sent.
        tau: (B, n) N·m, inverse-dynamics torque of the setpoint (nominal model).
        tau_ahead: (B, n) N·m, the same one step into a stop that would begin there.
        poses: (PK, B, n) rad, checked for collisions: P = STOP_MOMENTS + 2, at the setpoint, while that stop brakes
            and at its end, K times where drives have K expectations.
        values: (PB, M) of the motion at the setpoint, one step into the stop and while it brakes, (PKB, C) of `poses`,
            (B, S) of the estimate, compared with bounds: for `Safety.failed`.
    """

    reason: Ints
    tau: Floats
    tau_ahead: Floats
    poses: Floats
    values: tuple[Floats, Floats, Floats]


class Mode(IntEnum):
    """States of the supervisor, in the order of a run."""

    DISARMED = 0
    ARMING = 1
    RUNNING = 2
    STOPPING = 3
    HOLDING = 4
    LATCHED = 5


class Command(NamedTuple):
    """Command to the drives: each gives tau + kp (q − its angle) + kd (qd − its speed).

    Attributes:
        drive: mode, stiffness and damping.
        q: (B, n) rad. qd: (B, n) rad/s. tau: (B, n) N·m, feed-forward.
        powered: (B,) drives on; if False the brakes hold and the other fields are ignored.
        current_share: (B, n) share of its current limit that a drive may use.
    """

    drive: DriveMode
    q: Floats
    qd: Floats
    tau: Floats
    powered: Bools
    current_share: Floats
