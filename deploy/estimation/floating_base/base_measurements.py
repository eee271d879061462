"""Inputs of the floating base's filter. SI units; B robots, F feet; the base frame is the IMU's."""

from dataclasses import dataclass
from typing import NamedTuple

from robots.arrays import Bools, Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseNoise:
    """Noise of an IMU and of standing feet. Densities are standard deviations of white noise averaged over 1 s.

    Attributes:
        gyro: rad/s/√Hz. accelerometer: m/s²/√Hz.
        gyro_walk: rad/s²/√Hz, accelerometer_walk: m/s³/√Hz, random walks of the biases.
        gyro_bias: rad/s, accelerometer_bias: m/s², standard deviations when the IMU is switched on.
        slip: m/s/√Hz, velocity of a standing foot, with the errors of its kinematics.
        angular_acceleration: rad/s²/√Hz, jerk: m/s³/√Hz, of unmeasured motion between lost samples.
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
    """Newest packets of gyro and accelerometer.

    Attributes:
        t: (B,) s, when the gyro's sample was taken, on the runtime's clock.
        fresh: (B,) a gyro packet arrived since the last read.
        gyro: (B, 3) rad/s in the base frame.
        accelerometer: (B, 3) m/s² in the base frame, specific force: at rest +G along up. It may be older than `gyro`.
        t_accelerometer: (B,) s, when it was taken.
    """

    t: Floats
    fresh: Bools
    gyro: Floats
    accelerometer: Floats
    t_accelerometer: Floats


class Feet(NamedTuple):
    """Feet at the time of the gyro's sample.

    Attributes:
        stance: (B, F) feet that stand.
        position: (B, F, 3) m, velocity: (B, F, 3) m/s, relative to the base, in the base frame.
    """

    stance: Bools
    position: Floats
    velocity: Floats


class Upright(NamedTuple):
    """Direction of up by an IMU that estimates its own orientation; its yaw is not used.

    Attributes:
        fresh: (B,) there is a new one.
        up: (B, 3) unit vector, in the base frame at the time of the gyro's sample.
        variance: rad², of each of its two angles, for the gate.
        correlated_variance: rad², larger, for the correction: its bias is the same in many samples.
    """

    fresh: Bools
    up: Floats
    variance: float
    correlated_variance: float
