"""Recorded motions of working robots, their replay through encoders of any noise, and the joint estimates from it."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deploy.backends.sim.sensors import Sensors
from deploy.estimation.estimator import Estimator
from deploy.policy.policy import Policy
from deploy.simulation import simulate
from deploy.state import Sample, Setpoint, State
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
        encoder_q = robot.plant.readings["encoder"].copy()
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


@dataclass(frozen=True, slots=True, kw_only=True)
class JointEstimates:
    """Angles and speeds without and with the estimator, (T, B, n), rad and rad/s.

    Attributes:
        raw: latest packet. differenced: difference of the last two packets over the time between their stamps.
        q, qd: of the estimator. nees: its normalised estimation error squared.
    """

    raw: Floats
    differenced: Floats
    q: Floats
    qd: Floats
    nees: Floats


def initial_estimator(spec: RobotSpec, motion: Motion) -> Estimator:
    """Return an estimator that starts at the first setpoints of a motion."""
    estimator, zeros = Estimator(spec, motion.robots), np.zeros((motion.robots, spec.n))
    start = Setpoint(q=motion.sent[0, :, : spec.n], qd=zeros, qdd=zeros)
    estimator.follow(np.ones(motion.robots, dtype=bool), Setpoint(q=zeros, qd=zeros, qdd=zeros), start)
    return estimator


def estimate_motion(spec: RobotSpec, motion: Motion, noise: float | None) -> JointEstimates:
    """Estimate a motion from replayed packets; `noise` rad of the encoders, None as drawn."""
    estimator, rows = initial_estimator(spec, motion), []
    t_last, q_last = np.full(motion.robots, -np.inf), motion.q[0]
    differenced = np.zeros((motion.robots, spec.n))
    for tick, sample, sent in replay(spec, motion, noise):
        state, packet = estimator.step(tick * spec.dt, sample, sent), sample["encoder"]
        new = packet.t > t_last
        step = np.where(new, packet.t - t_last, 1.0)[:, None]
        differenced = np.where(new[:, None], (packet.value - q_last) / step, differenced)
        t_last, q_last = np.where(new, packet.t, t_last), np.where(new[:, None], packet.value, q_last)
        nees = _nees(spec, estimator, state, state.q - motion.q[tick - 1], state.qd - motion.qd[tick - 1])
        rows.append((packet.value.copy(), differenced, state.q, state.qd, nees))
    raw, differences, q, qd, nees = (np.array(column) for column in zip(*rows, strict=True))
    return JointEstimates(raw=raw, differenced=differences, q=q, qd=qd, nees=nees)


@np.errstate(invalid="ignore")  # before its first packet an estimate is infinitely old
def _nees(spec: RobotSpec, estimator: Estimator, state: State, q: Floats, qd: Floats) -> Floats:
    """(B, n) squared errors of angle and speed by their current joint covariance: mean 2 if consistent.

    Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), sec. 5.4.
    """
    joints = estimator.joints
    lag, density = state.t - joints.t_sample, spec.joint_array("acceleration_density")
    p00, p11 = state.q_var, joints.p11 + density * lag
    p01 = joints.p01 + lag * joints.p11 + density * lag**2 / 2
    return np.asarray((p11 * q**2 - 2 * p01 * q * qd + p00 * qd**2) / (p00 * p11 - p01**2))
