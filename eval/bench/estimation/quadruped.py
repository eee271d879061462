"""Quadrupeds that stand, sway, crouch and trot in MuJoCo, and drawn readings of their IMUs and feet.

Motions are simulated once. Noise, bias, delay and loss are drawn for each set of sensors, so that many draws share few
motions.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from deploy.estimation.floating_base.base_measurements import BaseNoise, Feet, Imu
from robots.arrays import Floats

MODEL = Path(__file__).with_name("quadruped.xml")
DT = 0.005
"""s between two IMU samples."""
FEET = 4
STAND = np.tile([0.0, 0.7, -1.4], FEET)
"""rad, abduction, hip and knee of each leg: the foot is under its hip."""
FRONT, DIAGONAL = np.array([1, 1, -1, -1]), np.array([0.0, 1.0, 1.0, 0.0])
SETTLED_S = 0.5
"""s to drop onto the feet."""
FOOT_STD, FOOT_SPEED_STD, CONTACT_N = 0.001, 0.02, 10.0
"""m and m/s: errors of the feet from encoders. N: force above which a foot is in contact."""
LAG_MAX, LOSS, FALSE_CONTACT = 2, 0.02, 0.002
"""Samples; shares of packets and of feet."""
NOISE = BaseNoise(
    gyro=5e-4,
    accelerometer=5e-3,
    gyro_walk=2e-5,
    accelerometer_walk=2e-4,
    gyro_bias=0.01,
    accelerometer_bias=0.1,
    slip=0.012,
    angular_acceleration=2.0,
    jerk=20.0,
)
"""Typical values from the data sheets of low-cost MEMS sensors."""


class QuadrupedTruth(NamedTuple):
    """True motion of M robots and exact readings of their IMU and feet: (T, M, ...).

    Attributes:
        gyro: (T, M, 3) rad/s. accelerometer: (T, M, 3) m/s².
        quat_wxyz: (T, M, 4). velocity_in_world: (T, M, 3) m/s.
        position: (T, M, F, 3) m, velocity: (T, M, F, 3) m/s, of the feet in the base frame. force: (T, M, F) N.
    """

    gyro: Floats
    accelerometer: Floats
    quat_wxyz: Floats
    velocity_in_world: Floats
    position: Floats
    velocity: Floats
    force: Floats


def simulate_quadrupeds(seeds: list[np.random.SeedSequence], seconds: float) -> QuadrupedTruth:
    """Simulate M robots, each with its own gait."""
    return _by_sensor(np.stack([_simulate(np.random.default_rng(seed), seconds) for seed in seeds], axis=1))


def _by_sensor(readings: Floats) -> QuadrupedTruth:
    """Split the sensors of quadruped.xml (T, M, 41) by name."""
    feet = readings[..., 13:].reshape(*readings.shape[:2], FEET, 7)
    gyro, force, quat_wxyz, velocity = np.split(readings[..., :13], (3, 6, 10), axis=-1)
    return QuadrupedTruth(gyro, force, quat_wxyz, velocity, feet[..., :3], feet[..., 3:6], feet[..., 6])


def _simulate(rng: np.random.Generator, seconds: float) -> Floats:
    """Return sensor data (T, 41) at every IMU sample."""
    model = mujoco.MjModel.from_xml_path(str(MODEL))
    data, gait = mujoco.MjData(model), Gait.draw(rng)
    data.qpos[7:] = STAND
    decimation, rows = round(DT / model.opt.timestep), []
    settling = round(SETTLED_S / model.opt.timestep)
    for step in range(-settling, round(seconds / model.opt.timestep)):
        data.ctrl[:] = gait.targets(max(0.0, step * model.opt.timestep))
        mujoco.mj_step(model, data)
        if step >= 0 and step % decimation == 0:
            rows.append(data.sensordata.copy())  # from before the step
    return np.array(rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gait:
    """Sines of sway, crouch, pitch and trot: amplitude (4,) rad, frequency (4,) Hz, phase (4,) rad."""

    amplitude: Floats
    frequency: Floats
    phase: Floats

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Gait":
        """Draw a gait; half of the robots do not trot."""
        trots = rng.random() < 0.5
        scale = 0.3 if trots else 1.0
        return cls(
            amplitude=rng.uniform(0.05, 0.2, 4) * [scale, scale, scale, trots],
            frequency=rng.uniform([0.3, 0.3, 0.3, 2.5], [0.8, 0.8, 0.8, 3.5]),
            phase=rng.uniform(0, 2 * np.pi, 4),
        )

    def targets(self, t: float) -> Floats:
        """Return joint angles (12,) rad; amplitudes rise from zero within the first second."""
        wave = min(1.0, t) * self.amplitude * np.sin(2 * np.pi * self.frequency * t + self.phase)
        sway, crouch, pitch, _ = wave
        stride = 2 * np.pi * self.frequency[3] * t + np.pi * DIAGONAL
        lift = min(1.0, t) * self.amplitude[3] * np.maximum(0.0, np.sin(stride))
        swing = -0.3 * min(1.0, t) * self.amplitude[3] * np.cos(stride)
        bend = crouch + pitch * FRONT + lift
        legs = np.stack([np.full(FEET, sway), bend - swing, -2 * bend], axis=1)
        return np.asarray(STAND + legs.ravel())


def sensor_packets(
    truth: QuadrupedTruth, noise: BaseNoise, seeds: list[np.random.SeedSequence]
) -> Iterator[tuple[float, Imu, Feet]]:
    """Yield time, IMU and feet of B sets of sensors, on the M robots in turn: noisy, late, sometimes lost."""
    rngs, ticks, rows = (
        [np.random.default_rng(seed) for seed in seeds],
        len(truth.gyro),
        np.arange(len(seeds)),
    )
    motion = rows % truth.gyro.shape[1]
    gyro_errors, force_errors = _imu_errors(rngs, ticks, noise)
    gyro, force = truth.gyro[:, motion] + gyro_errors, truth.accelerometer[:, motion] + force_errors
    lag = np.array([rng.integers(0, LAG_MAX + 1) for rng in rngs])
    lost = np.stack([rng.random(ticks) < LOSS for rng in rngs], axis=1)
    wrong = np.stack([rng.random((ticks, FEET)) < FALSE_CONTACT for rng in rngs], axis=1)
    foot_noise = np.stack([rng.standard_normal((2, ticks, FEET, 3)) for rng in rngs], axis=2)
    for tick in range(LAG_MAX, ticks):
        taken = tick - lag
        sampled = taken, motion
        yield (
            tick * DT,
            Imu(taken * DT, ~lost[tick], gyro[taken, rows], force[taken, rows], t_accelerometer=taken * DT),
            Feet(
                stance=(truth.force[sampled] > CONTACT_N) ^ wrong[tick],
                position=truth.position[sampled] + FOOT_STD * foot_noise[0, tick],
                velocity=truth.velocity[sampled] + FOOT_SPEED_STD * foot_noise[1, tick],
            ),
        )


def _imu_errors(rngs: list[np.random.Generator], ticks: int, noise: BaseNoise) -> tuple[Floats, Floats]:
    return (
        _errors(rngs, ticks, noise.gyro, noise.gyro_walk, noise.gyro_bias),
        _errors(rngs, ticks, noise.accelerometer, noise.accelerometer_walk, noise.accelerometer_bias),
    )


def _errors(rngs: list[np.random.Generator], ticks: int, density: float, walk: float, bias: float) -> Floats:
    """(T, B, 3) random-walk bias plus white noise."""
    rows = []
    for rng in rngs:
        start, steps = bias * rng.standard_normal(3), rng.standard_normal((ticks, 3))
        drift = start + walk * np.sqrt(DT) * np.cumsum(steps, axis=0)
        rows.append(drift + density / np.sqrt(DT) * rng.standard_normal((ticks, 3)))
    return np.stack(rows, axis=1)
