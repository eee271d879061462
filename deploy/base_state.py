"""What flows into and out of the estimate of a floating base: every array (B, ...) with B robots, F feet.

SI units; the base frame is the IMU's.
"""

from dataclasses import dataclass
from typing import NamedTuple

from deploy.state import Bools, Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseNoise:
    """How much an IMU and standing feet lie: densities are standard deviations of 1 s of white noise.

    Attributes:
        gyro: rad/s/√Hz. accelerometer: m/s²/√Hz.
        gyro_walk: rad/s²/√Hz, accelerometer_walk: m/s³/√Hz, of the biases.
        gyro_bias: rad/s, accelerometer_bias: m/s², standard deviations when the IMU is switched on.
        slip: m/s/√Hz, velocity of a standing foot, with the errors of its kinematics.
        angular_acceleration: rad/s²/√Hz, jerk: m/s³/√Hz, of the motion that nobody saw between lost samples.
    """

    gyro: float
    accelerometer: float
    gyro_walk: float
    accelerometer_walk: float
    gyro_bias: float
    accelerometer_bias: float
    slip: float
    angular_acceleration: float
    jerk: float


class Imu(NamedTuple):
    """What the IMU's bus delivered.

    Attributes:
        t: (B,) s, when the sample was taken, on the runtime's clock.
        fresh: (B,) whether a packet arrived since the last read.
        gyro: (B, 3) rad/s in the base frame.
        accelerometer: (B, 3) m/s² in the base frame, specific force: at rest +G along up.
    """

    t: Floats
    fresh: Bools
    gyro: Floats
    accelerometer: Floats


class Feet(NamedTuple):
    """The feet at the time of the IMU's sample.

    Attributes:
        stance: (B, F) whether a foot stands.
        position: (B, F, 3) m, velocity: (B, F, 3) m/s, relative to the base, in the base frame.
    """

    stance: Bools
    position: Floats
    velocity: Floats


class BaseState(NamedTuple):
    """The belief about now.

    Attributes:
        t: s, now.
        quat_wxyz: (B, 4) base in world, yaw counted from the seed.
        angular_velocity: (B, 3) rad/s in the base frame, without bias.
        velocity_in_world: (B, 3) m/s. velocity_in_base: (B, 3) m/s.
        gravity: (B, 3) direction of gravity in the base frame: (0, 0, −1) when upright.
        orientation_var: (B, 3) rad², of turns about the world's axes: the last is that of yaw.
        angular_velocity_var, velocity_in_world_var, velocity_in_base_var, gravity_var: (B, 3), in squared units.
        age: (B,) s since the newest sample was taken.
        innovation: (B, F, 3) of the newest sample, whitened by its covariance; 0 where a foot did not stand.
        stuck: (B,) the IMU repeats itself: its samples are left out.
        diverged: (B,) not to be believed: see `FloatingBase`.
    """

    t: float
    quat_wxyz: Floats
    angular_velocity: Floats
    velocity_in_world: Floats
    velocity_in_base: Floats
    gravity: Floats
    orientation_var: Floats
    angular_velocity_var: Floats
    velocity_in_world_var: Floats
    velocity_in_base_var: Floats
    gravity_var: Floats
    age: Floats
    innovation: Floats
    stuck: Bools
    diverged: Bools
