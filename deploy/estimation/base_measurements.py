"""What flows into the estimate of a floating base: every array (B, ...) with B robots, F feet.

SI units; the base frame is the IMU's.
"""

from dataclasses import dataclass
from typing import NamedTuple

from robots.arrays import Bools, Floats


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
        t: (B,) s, when the gyro's sample was taken, on the runtime's clock.
        fresh: (B,) whether a packet of the gyro arrived since the last read.
        gyro: (B, 3) rad/s in the base frame.
        accelerometer: (B, 3) m/s² in the base frame, specific force: at rest +G along up; the newest, be it older.
        t_accelerometer: (B,) s, when that was taken.
    """

    t: Floats
    fresh: Bools
    gyro: Floats
    accelerometer: Floats
    t_accelerometer: Floats


class Feet(NamedTuple):
    """The feet at the time of the IMU's sample.

    Attributes:
        stance: (B, F) whether a foot stands.
        position: (B, F, 3) m, velocity: (B, F, 3) m/s, relative to the base, in the base frame.
    """

    stance: Bools
    position: Floats
    velocity: Floats


class Upright(NamedTuple):
    """Where an IMU that estimates its orientation itself says up is; its yaw is not believed.

    Attributes:
        fresh: (B,) whether it said so since the last look.
        up: (B, 3) unit vector, in the base frame at the time of the IMU's sample.
        variance: rad², of each of its two angles.
        weighed: rad², variance with which it counts: what is wrong with it in the same way again and again is more.
    """

    fresh: Bools
    up: Floats
    variance: float
    weighed: float
