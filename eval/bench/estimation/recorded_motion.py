"""Recorded motions of working robots, and their replay through encoders of any noise."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deploy.backends.sim.backend import simulate
from deploy.backends.sim.sensors import Sensors
from deploy.policy.policy import Policy
from deploy.state import Sample, Setpoint
from eval.shard.job import ARM_S
from robots.arrays import Floats
from robots.draws import Draw
from robots.randomness import robot_seed
from robots.spec import RobotSpec

SEED, SHARD, MOTION_S = 11, 64, 5.0
"""Seed of the robots, robots recorded at once, s of a recording."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """True joint motion of B robots, at the ticks of the runtime.

    Attributes:
        q, qd: (T, B, n) rad and rad/s. encoder_q: (T, B, n) rad, true angle at the encoder.
        sent: (T, B, 2n) setpoints (q, qd) that were sent to the drives.
        draw, seeds: of the robots and their encoders.
    """

    q: Floats
    qd: Floats
    encoder_q: Floats
    sent: Floats
    draw: Draw
    seeds: list[np.random.SeedSequence]

    @property
    def robots(self) -> int:
        """B."""
        return len(self.seeds)


def record_motion(spec: RobotSpec, policy: Path, first: int) -> Motion:
    """Record `SHARD` robots under the policy, from robot `first` of the seed on."""
    seeds = [robot_seed(SEED, robot) for robot in range(first, first + SHARD)]
    loaded = Policy.load(policy, spec)
    runtime, robot = simulate(spec, loaded.contract, seeds, loaded)
    for _ in range(round(ARM_S / spec.dt)):
        runtime.tick()
    runtime.arm(np.ones(SHARD, dtype=bool))
    rows: list[tuple[Floats, ...]] = []
    for _ in range(round(MOTION_S / spec.dt)):
        runtime.tick()
        truth, setpoint = robot.truth(), runtime.setpoint
        encoder_q = robot.plant.reading("encoder").copy()
        rows.append((truth.q.copy(), truth.qd.copy(), encoder_q, np.hstack((setpoint.q, setpoint.qd))))
    q, qd, encoder_q, sent = (np.array(column) for column in zip(*rows, strict=True))
    return Motion(q=q, qd=qd, encoder_q=encoder_q, sent=sent, draw=robot.draw, seeds=seeds)


def replay(spec: RobotSpec, motion: Motion, noise: float | None) -> Iterator[tuple[int, Sample, Setpoint]]:
    """Yield tick number (from 1), delivered sample and sent setpoint; `noise` rad of the encoders, None as drawn."""
    draw = motion.draw
    if noise is not None:
        draw = draw.replaced({"sensors.noise": noise / spec.sensors["encoder"].noise})
    sensors = Sensors(spec, draw, motion.seeds)
    truth, columns = np.zeros(sensors.value.shape), sensors.columns["encoder"]
    truth[:, columns] = motion.encoder_q[0]
    sensors.reset(np.ones(motion.robots, dtype=bool), truth)
    for tick, (encoder_q, sent) in enumerate(zip(motion.encoder_q, motion.sent, strict=True), start=1):
        truth[:, columns] = encoder_q
        sensors.sample(truth)
        q, qd = sent[:, : spec.n], sent[:, spec.n :]
        yield tick, sensors.read(), Setpoint(q=q, qd=qd, qdd=np.zeros_like(encoder_q))
