"""The base of a walking robot in the tick: its IMU's packets, its feet by its joints, and the filter of both."""

from dataclasses import replace

import numpy as np

from deploy.estimation.base_filter import FloatingBase
from deploy.estimation.base_measurements import BaseNoise, Feet, Imu, Upright
from deploy.estimation.rotations import matrix
from deploy.masks import any_true
from deploy.stage import Stage
from deploy.state import Packet, Reason, Sample, State
from robots.arrays import Bools, Floats
from robots.models.fleet import Fleet
from robots.sensors import Sensor
from robots.spec import RobotSpec
from robots.tables import Base

CONTACT_N = 10.0
"""N, above which a foot's sensor says that it stands."""
DOWN = (0.0, 0.0, -1.0)
"""Where gravity points in the frame of a base that stands upright."""
SAID_S = 0.1
"""s after which what the IMU said of up is not used any more."""
LOOK_S = 0.016
"""s between two looks at feet and at what the IMU says of up: what it measures itself is integrated on every tick."""

AGAIN_S = 1.0
"""s; what the IMU says of up has a bias, which stays: all looks of so long count as one look at it. An estimate, with
which robots as drawn are about as wrong as the filter claims."""


class Walker(Stage):
    """Belief about B bases.

    Attributes:
        gravity: (B, 3) its direction in the base frame, as it was believed last. t_up: (B,) s, when the IMU's own
            orientation was taken that was used last.
    """

    carried = ("gravity", "t_up")
    parts = ("filter",)

    def __init__(self, spec: RobotSpec, base: Base, robots: int) -> None:
        """Read the IMU's data sheet.

        Args:
            spec: the robot. base: its base.
            robots: B.
        """
        dt = 1.0 / spec.sensors["gyro"].rate_hz
        self._dt, self._look = spec.dt, max(1, round(LOOK_S / spec.dt))
        noise = _noise(spec, base, dt)
        # Slip is said of a second: of that, fewer looks see as much.
        noise = replace(noise, slip=noise.slip / np.sqrt(self._look * spec.dt / dt))
        self.filter = FloatingBase(noise, dt, robots, len(base.feet))
        self.gravity, self.t_up = np.tile(DOWN, (robots, 1)), np.full(robots, -np.inf)
        self._fleet, self._foot_m, self._said = Fleet(spec, robots), base.foot_m, None
        if "orientation" in spec.sensors:
            self._said = _variances(spec.sensors["orientation"], looks=AGAIN_S / (self._look * spec.dt))

    def reset(self, ids: Bools) -> None:
        """Forget robots where `ids` (B,) holds."""
        self.filter.reset(ids)
        self.gravity[ids], self.t_up[ids] = DOWN, -np.inf

    def step(self, t: float, sample: Sample, state: State) -> State:
        """The same state with the base in it; what is wrong with that is wrong with the state."""
        gyro, accelerometer = sample["gyro"], sample["accelerometer"]
        imu = Imu(gyro.t, gyro.fresh, gyro.value, accelerometer.value, accelerometer.t)
        looks = round(t / self._dt) % self._look == 0
        seen = (self._feet(sample, state), self._upright(t, sample, gyro)) if looks else (None, None)
        base = self.filter.step(t, imu, *seen)
        self.gravity[:] = base.gravity
        fault = state.fault.copy()
        for wrong, reason in ((base.stuck, Reason.STUCK), (base.diverged, Reason.DIVERGED)):
            if any_true(wrong):
                fault[wrong] |= np.int64(reason)
        return state._replace(age=np.maximum(state.age, base.age), fault=fault, base=base)

    def _feet(self, sample: Sample, state: State) -> Feet:
        self._fleet.place(state.q)
        position = self._fleet.feet_position
        return Feet(self._stance(sample, position), position, self._fleet.feet_velocity(state.qd))

    def _stance(self, sample: Sample, position: Floats) -> Bools:
        """(B, F) which feet stand: those that feel it, or those that are lowest."""
        if "contact" in sample:
            return np.asarray(sample["contact"].value > CONTACT_N)
        depth = np.matvec(position, self.gravity)
        return np.asarray(depth >= depth.max(axis=1, keepdims=True) - self._foot_m)

    def _upright(self, t: float, sample: Sample, gyro: Packet) -> Upright | None:
        """What the IMU itself says of up, carried from when it said so to when its gyro's sample was taken.

        What it says of the future, of long ago, or said before counts as not said.
        """
        if self._said is None:
            return None
        said = sample["orientation"]
        recent = (said.t <= t + self._dt) & (said.t > t - SAID_S)
        fresh = np.isfinite(said.value).all(axis=1) & recent & (said.t > self.t_up)
        np.copyto(self.t_up, said.t, where=fresh)
        quat = np.where(fresh[:, None], said.value, [1.0, 0.0, 0.0, 0.0])
        up = matrix(quat / np.linalg.norm(quat, axis=1, keepdims=True))[:, 2]
        later = np.where(fresh, gyro.t - said.t, 0.0)[:, None]
        up = up - later * np.cross(np.nan_to_num(gyro.value), up)
        return Upright(fresh, up / np.linalg.norm(up, axis=1, keepdims=True), *self._said)


def _variances(orientation: Sensor, looks: float) -> tuple[float, float]:
    """Rad² of one look at up, and of one of so many that count as one look at the sensor's bias."""
    noise, bias = (4.0 * var for var in (orientation.variance, orientation.bias**2 / 3.0))  # of half an angle
    return noise + bias, noise + max(1.0, looks) * bias


def _noise(spec: RobotSpec, base: Base, dt: float) -> BaseNoise:
    gyro, accelerometer = spec.sensors["gyro"], spec.sensors["accelerometer"]
    return BaseNoise(
        gyro=_density(gyro, dt),
        accelerometer=_density(accelerometer, dt),
        gyro_walk=_walk(gyro),
        accelerometer_walk=_walk(accelerometer),
        gyro_bias=gyro.bias / np.sqrt(3.0),
        accelerometer_bias=accelerometer.bias / np.sqrt(3.0),
        slip=base.slip,
        angular_acceleration=base.angular_acceleration,
        jerk=base.jerk,
    )


def _density(sensor: Sensor, dt: float) -> float:
    """Of 1 s of white noise, from one sample's."""
    return float(np.sqrt(sensor.variance * dt))


def _walk(sensor: Sensor) -> float:
    """Of 1 s, from what a bias walks in an hour."""
    return float(sensor.drift / np.sqrt(3600.0))
