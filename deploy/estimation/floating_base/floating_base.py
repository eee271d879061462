"""Floating base in the tick: IMU packets, feet by joint kinematics, and the filter of both."""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from deploy.estimation.capability import CapabilityEstimator
from deploy.estimation.floating_base.base_filter import BaseFilter
from deploy.estimation.floating_base.base_measurements import BaseNoise, Feet, Imu, Upright
from deploy.estimation.sample_count import sample_count
from deploy.masks import any_true
from deploy.reasons import Reason
from deploy.state import Packet, Sample, State
from robots.arrays import Bools, Floats
from robots.capabilities import Capability
from robots.models.fleet import Fleet
from robots.rotations import matrix
from robots.sensors import Kind, Sensor
from robots.spec import RobotSpec
from robots.tables import Base

CONTACT_N = 10.0
"""N at a foot's contact sensor above which it stands."""
DOWN = (0.0, 0.0, -1.0)
"""Direction of gravity in the frame of an upright base."""
ORIENTATION_MAX_AGE_S = 0.1
"""s after which an orientation that the IMU estimated is not used."""
LOOK_S = 0.016
"""s between two corrections by feet and by the IMU's orientation; its gyro and accelerometer are integrated always."""
CORRELATION_S = 1.0
"""s in which all orientation samples count as one measurement of up, for they have the same bias. An estimate: robots
as drawn then have about the errors that the filter claims."""


class FloatingBase(CapabilityEstimator):
    """Orientation and velocity of B bases.

    Attributes:
        gravity: (B, 3) its estimated direction in the base frame.
        t_up: (B,) s, when the newest used orientation of the IMU was taken.
    """

    capability: ClassVar[Capability] = "floating_base"
    sensors: ClassVar[tuple[Kind, ...]] = ("gyro", "accelerometer", "orientation", "contact")
    carried = ("gravity", "t_up")
    parts = ("filter",)

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        if (base := spec.base) is None:
            raise RuntimeError(f"{spec.name} has no floating base")
        dt = 1.0 / spec.sensors["gyro"].rate_hz
        self._dt, self._look = spec.dt, sample_count(LOOK_S, spec.dt)
        look_s, orientation = self._look * spec.dt, spec.sensors.get("orientation")
        self._up_variances = _up_variances(orientation, CORRELATION_S / look_s) if orientation else None
        # Slip is white noise of the IMU's rate: fewer samples in a second must weigh as much.
        noise = _noise(spec, base, dt)
        noise = replace(noise, slip=noise.slip / np.sqrt(look_s / dt))
        tilt_s = max(look_s, 1.0 / orientation.rate_hz) if orientation else look_s
        self.filter = BaseFilter(noise, dt, robots, len(base.feet), look_s=look_s, tilt_s=tilt_s)
        self.gravity, self.t_up = np.tile(DOWN, (robots, 1)), np.full(robots, -np.inf)
        self._fleet, self._foot_m = Fleet(spec, robots), base.foot_m

    def reset(self, ids: Bools) -> None:
        """Forget robots `ids` (B,)."""
        self.filter.reset(ids)
        self.gravity[ids], self.t_up[ids] = DOWN, -np.inf

    def step(self, t: float, sample: Sample, state: State, due: bool) -> State:
        """Return the state with the base in it; the base's faults and age become the state's."""
        del due
        gyro, accelerometer = sample["gyro"], sample["accelerometer"]
        imu = Imu(gyro.t, gyro.fresh, gyro.value, accelerometer.value, accelerometer.t)
        feet, up = None, None
        if round(t / self._dt) % self._look == 0:
            feet, up = self._feet(sample, state), self.measured_up(t, sample, gyro)
        base = self.filter.step(t, imu, feet, up)
        self.gravity[:] = base.gravity
        fault = state.fault.copy()
        for wrong, reason in ((base.stuck, Reason.STUCK), (base.diverged, Reason.DIVERGED)):
            if any_true(wrong):
                fault[wrong] |= np.int64(reason)
        return state._replace(age=np.maximum(state.age, base.age), fault=fault, base=base)

    def _feet(self, sample: Sample, state: State) -> Feet:
        kinematics = self._fleet.kinematics(state.q)
        position = kinematics.feet_position
        return Feet(self._stance(sample, position), position, kinematics.feet_velocity(state.qd))

    def _stance(self, sample: Sample, position: Floats) -> Bools:
        """Return the feet (B, F) that stand: by contact sensors, else those within `foot_m` of the lowest."""
        if "contact" in sample:
            return np.asarray(sample["contact"].value > CONTACT_N)
        depth = np.matvec(position, self.gravity)
        return np.asarray(depth >= depth.max(axis=1, keepdims=True) - self._foot_m)

    def height(self, sample: Sample, state: State) -> Floats:
        """Return (B, 1) m, the IMU above the mean of the standing feet; above the lowest foot where none stands."""
        position = self._fleet.kinematics(state.q, jacobians=False).feet_position
        depth, stands = np.matvec(position, self.gravity), self._stance(sample, position)
        standing = stands.sum(axis=1)
        mean = np.where(stands, depth, 0.0).sum(axis=1) / np.maximum(standing, 1)
        height: Floats = np.where(standing > 0, mean, depth.max(axis=1))
        return height[:, None]

    def measured_up(self, t: float, sample: Sample, gyro: Packet) -> Upright | None:
        """Return up by the IMU's orientation, turned to the time of the gyro's sample; None without that sensor.

        Packets from the future, too old ones and those that were used before are not fresh.
        """
        if self._up_variances is None:
            return None
        packet = sample["orientation"]
        recent = (packet.t <= t + self._dt) & (packet.t > t - ORIENTATION_MAX_AGE_S)
        fresh = np.isfinite(packet.value).all(axis=1) & recent & (packet.t > self.t_up)
        np.copyto(self.t_up, packet.t, where=fresh)
        quat = np.where(fresh[:, None], packet.value, [1.0, 0.0, 0.0, 0.0])
        up = matrix(quat / np.linalg.norm(quat, axis=1, keepdims=True))[:, 2]
        lag = np.where(fresh, gyro.t - packet.t, 0.0)[:, None]
        up = up - lag * np.cross(np.nan_to_num(gyro.value), up)
        return Upright(fresh, up / np.linalg.norm(up, axis=1, keepdims=True), *self._up_variances)


def _up_variances(orientation: Sensor, correlated: float) -> tuple[float, float]:
    """Return variances (rad²) of up: of one sample, and of one of so many `correlated` samples (same bias)."""
    noise, bias = (4.0 * var for var in (orientation.variance, orientation.bias**2 / 3.0))  # of half an angle
    return noise + bias, noise + max(1.0, correlated) * bias


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
    """Return the noise density from the variance of samples with period dt."""
    return float(np.sqrt(sensor.variance * dt))


def _walk(sensor: Sensor) -> float:
    """Return the random walk of a bias in 1 s from that in an hour."""
    return float(sensor.drift / np.sqrt(3600.0))
