from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from deploy.estimation.floating_base.base_filter import BaseFilter
from deploy.estimation.floating_base.base_measurements import BaseNoise, Feet, Imu
from deploy.estimation.floating_base.base_model import G

DT, LOOK_S, F = 0.005, 0.015, 4
NOISE = BaseNoise(
    gyro=5e-4,
    accelerometer=5e-3,
    gyro_walk=1e-4,
    accelerometer_walk=1e-3,
    gyro_bias=0.01,
    accelerometer_bias=0.1,
    slip=0.004,
    angular_acceleration=2.0,
    jerk=20.0,
)
DOWN = np.array([0.0, 0.0, -G])


def base_filter(robots, noise=NOISE):
    return BaseFilter(noise, DT, robots, F, look_s=LOOK_S)


def cross(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


class World:
    """Robots that turn and accelerate smoothly, seen by IMUs as bad as NOISE says: `R`, `v` in the base, biases."""

    def __init__(self, seed, robots, ticks):
        rng = self.rng = np.random.default_rng(seed)
        t = DT * np.arange(ticks)[:, None, None]
        speed, phase = rng.uniform(2, 8, (2, robots, 3)), rng.uniform(0, 6, (2, robots, 3))
        self.w = 0.5 * np.sin(speed[0] * t + phase[0])
        a = (
            np.minimum(1.0, 5 * t) * 2.0 * np.sin(speed[1] * t + phase[1])
        )  # of the base, in the world; first none
        self.R, v = np.empty((ticks, robots, 3, 3)), np.zeros((ticks, robots, 3))
        self.R[0] = Rotation.from_rotvec(rng.normal(0, 0.05, (robots, 3)) * [1, 1, 0]).as_matrix()
        for k in range(1, ticks):
            turn = Rotation.from_rotvec(DT * (self.w[k - 1] + self.w[k]) / 2).as_matrix()
            self.R[k] = self.R[k - 1] @ turn
            v[k] = v[k - 1] + DT * (a[k - 1] + a[k]) / 2
        v += rng.normal(0, 0.3, (robots, 3))
        into_base = self.R.swapaxes(2, 3)
        self.v, self.f = (into_base @ v[..., None])[..., 0], (into_base @ (a - DOWN)[..., None])[..., 0]
        self.gyro_bias, self.force_bias = (
            bias * rng.standard_normal((robots, 3))
            + walk * np.sqrt(DT) * np.cumsum(rng.standard_normal((ticks, robots, 3)), axis=0)
            for bias, walk in (
                (NOISE.gyro_bias, NOISE.gyro_walk),
                (NOISE.accelerometer_bias, NOISE.accelerometer_walk),
            )
        )
        self.gyro, self.force = (
            value + bias + density / np.sqrt(DT) * rng.standard_normal(value.shape)
            for value, bias, density in (
                (self.w, self.gyro_bias, NOISE.gyro),
                (self.f, self.force_bias, NOISE.accelerometer),
            )
        )

    def feet(self, at, slipping=0.0):
        """Of the moments `at` (B,), some in the air, and some on ice."""
        rng, row = self.rng, np.arange(len(at))
        p = rng.uniform(-0.4, 0.4, (len(at), F, 3))
        slip = NOISE.slip / np.sqrt(DT) * rng.standard_normal(p.shape)
        slip += (rng.random((len(at), F, 1)) < slipping) * rng.normal(0, 1.0, p.shape)
        velocity = slip - self.v[at, row][:, None] - np.cross(self.w[at, row][:, None], p)
        return Feet(stance=rng.random((len(at), F)) < 0.7, position=p, velocity=velocity)

    def packets(self, loss=0.0, lag_max=0, slipping=0.0):
        """What an unkind bus delivers: each robot its own delay, losses, and old packets that come again."""
        rng, robots = self.rng, self.v.shape[1]
        lag, row = rng.integers(0, lag_max + 1, robots), np.arange(robots)
        for tick in range(lag_max + 3, len(self.v)):
            at = tick - lag - 3 * (rng.random(robots) < 0.05 * (lag_max > 0))
            fresh = rng.random(robots) >= loss
            if loss and tick % 150 > 130:
                fresh[0] = False  # and long outages
            taken = DT * at
            imu = Imu(taken, fresh, self.gyro[at, row], self.force[at, row], t_accelerometer=taken)
            yield DT * tick, imu, self.feet(at, slipping)


def one(record, robot):
    """The robot's own row."""
    return type(record)(*(values[robot] for values in record))


@cache
def worked():
    """What two robots carry in the middle of their work, and what comes next."""
    stream, base = list(World(3, 2, 460).packets()), base_filter(2)
    for packets in stream[:200]:
        base.step(*packets)
    return base.save(), stream[200:]


def settled():
    """An estimator of two robots in the middle of its work, and what comes next."""
    base, (carried, stream) = base_filter(2), worked()
    base.restore(carried)
    return base, stream
