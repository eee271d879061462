"""A quadruped that stands, sways, crouches and trots in MuJoCo, and the IMUs and feet that watch it.

The motions come from physics and are kept; noise, bias, delay and loss are drawn for each watcher, so that many draws
watch few motions.
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
LEFT, FRONT, DIAGONAL = np.array([1, -1, 1, -1]), np.array([1, 1, -1, -1]), np.array([0.0, 1.0, 1.0, 0.0])
SETTLED_S = 0.5
"""s to fall on its feet."""
FOOT_STD, FOOT_SPEED_STD, CONTACT_N = 0.001, 0.02, 10.0
"""m, m/s: errors of feet by encoders; N: above it a foot is said to stand."""
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
"""As the data sheets of cheap MEMS have it."""


class Truth(NamedTuple):
    """What M robots did, and a perfect IMU and perfect feet: (T, M, ...).

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


def move(seeds: list[np.random.SeedSequence], seconds: float) -> Truth:
    """M robots, each with rhythms of its own."""
    return split(np.stack([_sensors(np.random.default_rng(seed), seconds) for seed in seeds], axis=1))


def split(readings: Floats) -> Truth:
    """The sensors of quadruped.xml (T, M, 41) by name."""
    feet = readings[..., 13:].reshape(*readings.shape[:2], FEET, 7)
    gyro, force, quat_wxyz, velocity = np.split(readings[..., :13], (3, 6, 10), axis=-1)
    return Truth(gyro, force, quat_wxyz, velocity, feet[..., :3], feet[..., 3:6], feet[..., 6])


def _sensors(rng: np.random.Generator, seconds: float) -> Floats:
    """(T, 41) at every sample."""
    model = mujoco.MjModel.from_xml_path(str(MODEL))
    data, rhythm = mujoco.MjData(model), Rhythm.draw(rng)
    data.qpos[7:] = STAND
    every, rows = round(DT / model.opt.timestep), []
    settled = round(SETTLED_S / model.opt.timestep)
    for step in range(-settled, round(seconds / model.opt.timestep)):
        data.ctrl[:] = rhythm.targets(max(0.0, step * model.opt.timestep))
        mujoco.mj_step(model, data)
        if step >= 0 and step % every == 0:
            rows.append(data.sensordata.copy())  # of the moment before the step
    return np.array(rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rhythm:
    """Sines of sway, crouch and pitch, and of a trot: amplitude (4,) rad, frequency (4,) Hz, phase (4,) rad."""

    amplitude: Floats
    frequency: Floats
    phase: Floats

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Rhythm":
        """One at random; half of the robots do not trot."""
        trots = rng.random() < 0.5
        calm = 0.3 if trots else 1.0
        return cls(
            amplitude=rng.uniform(0.05, 0.2, 4) * [calm, calm, calm, trots],
            frequency=rng.uniform([0.3, 0.3, 0.3, 2.5], [0.8, 0.8, 0.8, 3.5]),
            phase=rng.uniform(0, 2 * np.pi, 4),
        )

    def targets(self, t: float) -> Floats:
        """(12,) rad, joint angles, from the stand into full swing within a second."""
        wave = min(1.0, t) * self.amplitude * np.sin(2 * np.pi * self.frequency * t + self.phase)
        sway, crouch, pitch, _ = wave
        stride = 2 * np.pi * self.frequency[3] * t + np.pi * DIAGONAL
        lift = min(1.0, t) * self.amplitude[3] * np.maximum(0.0, np.sin(stride))
        swing = -0.3 * min(1.0, t) * self.amplitude[3] * np.cos(stride)
        bend = crouch + pitch * FRONT + lift
        legs = np.stack([np.full(FEET, sway), bend - swing, -2 * bend], axis=1)
        return np.asarray(STAND + legs.ravel())


def watch(
    truth: Truth, noise: BaseNoise, seeds: list[np.random.SeedSequence]
) -> Iterator[tuple[float, Imu, Feet]]:
    """What B watchers, in turn on the M robots, deliver at each tick: late, noisy, sometimes nothing."""
    rngs, robots = [np.random.default_rng(seed) for seed in seeds], len(seeds)
    ticks, who = len(truth.gyro), np.arange(robots) % truth.gyro.shape[1]
    gyro, force = (
        values[:, who] + _errors(rngs, ticks, density, walk, bias)
        for values, density, walk, bias in (
            (truth.gyro, noise.gyro, noise.gyro_walk, noise.gyro_bias),
            (truth.accelerometer, noise.accelerometer, noise.accelerometer_walk, noise.accelerometer_bias),
        )
    )
    lag = np.array([rng.integers(0, LAG_MAX + 1) for rng in rngs])
    lost = np.stack([rng.random(ticks) < LOSS for rng in rngs], axis=1)
    wrong = np.stack([rng.random((ticks, FEET)) < FALSE_CONTACT for rng in rngs], axis=1)
    shake = np.stack([rng.standard_normal((2, ticks, FEET, 3)) for rng in rngs], axis=2)
    for tick in range(LAG_MAX, ticks):
        at, row = tick - lag, np.arange(robots)
        seen = at, who
        yield (
            tick * DT,
            Imu(
                t=at * DT,
                fresh=~lost[tick],
                gyro=gyro[at, row],
                accelerometer=force[at, row],
                t_accelerometer=at * DT,
            ),
            Feet(
                stance=(truth.force[seen] > CONTACT_N) ^ wrong[tick],
                position=truth.position[seen] + FOOT_STD * shake[0, tick],
                velocity=truth.velocity[seen] + FOOT_SPEED_STD * shake[1, tick],
            ),
        )


def _errors(rngs: list[np.random.Generator], ticks: int, density: float, walk: float, bias: float) -> Floats:
    """(T, B, 3): bias that walks, and white noise."""
    rows = []
    for rng in rngs:
        walked = bias * rng.standard_normal(3) + walk * np.sqrt(DT) * np.cumsum(
            rng.standard_normal((ticks, 3)), axis=0
        )
        rows.append(walked + density / np.sqrt(DT) * rng.standard_normal((ticks, 3)))
    return np.stack(rows, axis=1)
