"""What the estimator is worth: the same motions, heard through the same bus, with it and without.

Robots really move under the policy; what they did is kept, and played again through encoders of any noise. Raw is the
newest packet as it is; differenced is the difference of the last two that arrived, over the time between them.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import stats

from deploy.backends.sim.backend import simulate
from deploy.backends.sim.sensors import Sensors
from deploy.estimation.estimator import Estimator
from deploy.policy.policy import Policy
from deploy.state import Packet, Sample, Setpoint, State
from deploy.telemetry.output_files import replacing
from eval.bench.estimation.encoder import draw_encoder
from eval.bench.estimation.recorded_packets import Heard, Motion
from eval.shard.job import ARM_S
from robots.arrays import Floats
from robots.randomness import robot_seed
from robots.spec import RobotSpec

SEED, ROBOTS, SHARD = 11, 1024, 64
MOVED_S, SETTLED_S = 5.0, 1.0
NOISES = (None, 0.0005, 0.001, 0.002, 0.005, 0.01)
"""rad, the same for all robots; None: each as it was drawn."""
OUTAGE_S = 0.1


def estimate(spec: RobotSpec, policy: Path, console: Console, picture: Path | None = None) -> None:
    """Errors over a table of noises, consistency over many draws, an outage, the cost; a picture if asked for."""
    motions = [move(spec, policy, first) for first in range(0, ROBOTS, SHARD)]
    some = motions[: 256 // SHARD]
    table = Table(
        *(
            "encoder noise",
            "q: raw",
            "estimated",
            "qd: differenced",
            "estimated",
            "÷",
            "delay left in q: raw",
            "estimated",
        ),
        title=f"RMSE of {len(some) * SHARD} robots, mrad and mrad/s; late and lost as drawn",
    )
    for noise in NOISES:
        table.add_row("as drawn" if noise is None else f"{1e3 * noise:g} mrad", *_errors(spec, some, noise))
    console.print(table)
    console.print(_consistency(spec, motions))
    console.print(_outage(spec, some[0]))
    console.print(_cost(spec, some[0]))
    if picture is not None:
        with replacing(picture) as file:
            draw_encoder(spec, some[0], hear(spec, some[0], None), file)


def move(spec: RobotSpec, policy: Path, first: int) -> Motion:
    """Robots `first` and after, at work."""
    seeds = [robot_seed(SEED, robot) for robot in range(first, first + SHARD)]
    brain = Policy.load(policy, spec)
    runtime, robot = simulate(spec, brain.contract, seeds, brain)
    for _ in range(round(ARM_S / spec.dt)):
        runtime.tick()
    runtime.arm(np.ones(SHARD, dtype=bool))
    rows: list[tuple[Floats, ...]] = []
    for _ in range(round(MOVED_S / spec.dt)):
        runtime.tick()
        truth, setpoint = robot.truth(), runtime.setpoint
        seen = robot.plant.reading("encoder").copy()
        rows.append((truth.q.copy(), truth.qd.copy(), seen, np.hstack((setpoint.q, setpoint.qd))))
    q, qd, seen, sent = (np.array(column) for column in zip(*rows, strict=True))
    return Motion(q=q, qd=qd, seen=seen, sent=sent, draw=robot.draw, seeds=seeds)


def _samples(spec: RobotSpec, motion: Motion, noise: float | None) -> Iterator[tuple[int, Sample, Setpoint]]:
    """Each tick from 1 on: what the bus delivers, and what was sent."""
    nominal, draw = spec.sensors["encoder"].noise, motion.draw
    if noise is not None:
        draw = draw.replaced({"sensors.noise": noise / nominal})
    sensors = Sensors(spec, draw, motion.seeds)
    truth, columns = np.zeros(sensors.value.shape), sensors.columns["encoder"]
    truth[:, columns] = motion.seen[0]
    sensors.reset(np.ones(motion.robots, dtype=bool), truth)
    for tick, (seen, sent) in enumerate(zip(motion.seen, motion.sent, strict=True), start=1):
        truth[:, columns] = seen
        sensors.sample(truth)
        yield (
            tick,
            sensors.read(),
            Setpoint(q=sent[:, : spec.n], qd=sent[:, spec.n :], qdd=np.zeros_like(seen)),
        )


def _estimator(spec: RobotSpec, motion: Motion) -> Estimator:
    """One that knows where its robots were sent at first."""
    estimator, rest = Estimator(spec, motion.robots), np.zeros((motion.robots, spec.n))
    nowhere, q = Setpoint(q=rest, qd=rest, qdd=rest), motion.sent[0, :, : spec.n]
    estimator.follow(np.ones(motion.robots, dtype=bool), nowhere, Setpoint(q=q, qd=rest, qdd=rest))
    return estimator


def hear(spec: RobotSpec, motion: Motion, noise: float | None) -> Heard:
    """What bus, differences and estimator make of a motion; `noise` rad of the encoders, None as drawn."""
    estimator, rows = _estimator(spec, motion), []
    t_last, q_last = np.full(motion.robots, -np.inf), motion.q[0]
    differenced = np.zeros((motion.robots, spec.n))
    for tick, sample, sent in _samples(spec, motion, noise):
        state, packet = estimator.step(tick * spec.dt, sample, sent), sample["encoder"]
        new = packet.t > t_last
        step = np.where(new, packet.t - t_last, 1.0)[:, None]
        differenced = np.where(new[:, None], (packet.value - q_last) / step, differenced)
        t_last, q_last = np.where(new, packet.t, t_last), np.where(new[:, None], packet.value, q_last)
        error = state.q - motion.q[tick - 1], state.qd - motion.qd[tick - 1]
        nees = _nees(spec, estimator, state, *error)
        rows.append((packet.value.copy(), differenced, state.q, state.qd, nees))
    raw, differences, q, qd, nees = (np.array(column) for column in zip(*rows, strict=True))
    return Heard(raw=raw, differenced=differences, q=q, qd=qd, nees=nees)


@np.errstate(invalid="ignore")  # before its first packet an estimate is infinitely old
def _nees(spec: RobotSpec, estimator: Estimator, state: State, q: Floats, qd: Floats) -> Floats:
    """(B, n) squared errors of angle and speed by their joint covariance now: 2 on average if it is true.

    Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), sec. 5.4.
    """
    joints = estimator.joints
    lag, density = state.t - joints.t_sample, spec.joint_array("acceleration_density")
    p00, p11 = state.q_var, joints.p11 + density * lag
    p01 = joints.p01 + lag * joints.p11 + density * lag**2 / 2
    return np.asarray((p11 * q**2 - 2 * p01 * q * qd + p00 * qd**2) / (p00 * p11 - p01**2))


def _errors(spec: RobotSpec, motions: list[Motion], noise: float | None) -> list[str]:
    """A row of the table."""
    settled = round(SETTLED_S / spec.dt)
    heard = [hear(spec, motion, noise) for motion in motions]
    q, qd = (
        np.concatenate([getattr(motion, name)[settled:] for motion in motions], axis=1)
        for name in ("q", "qd")
    )
    raw, differenced, q_hat, qd_hat = (
        np.concatenate([getattr(one, name)[settled:] for one in heard], axis=1)
        for name in ("raw", "differenced", "q", "qd")
    )
    rmse = [
        1e3 * np.sqrt(np.mean((a - b) ** 2))
        for a, b in ((raw, q), (q_hat, q), (differenced, qd), (qd_hat, qd))
    ]
    # A late angle is wrong in proportion to the speed: the slope of error over speed is the delay that is left.
    left = [1e3 * np.sum((q - a) * qd) / np.sum(qd**2) for a in (raw, q_hat)]
    return [*(f"{value:.2f}" for value in rmse), f"{rmse[3] / rmse[2]:.3f}", *(f"{ms:.2f} ms" for ms in left)]


def _consistency(spec: RobotSpec, motions: list[Motion]) -> str:
    """NEES of every draw, over all that it did; the band is that of independent draws seen once (Bar-Shalom, 5.4.2).

    The mean of one moment per draw would do, if errors were Gaussian: they are not, and it strays twice as far.
    """
    settled = round(SETTLED_S / spec.dt)
    nees = np.concatenate([hear(spec, motion, None).nees[settled:].mean(axis=0) for motion in motions])
    band = np.array(stats.chi2.interval(0.95, 2 * nees.size)) / nees.size
    found, unsure = nees.mean(), nees.mean(axis=1).std(ddof=1) / np.sqrt(len(nees))
    place = "inside" if band[0] <= found <= band[1] else "outside"
    joints = nees.mean(axis=0)
    return (
        f"consistency over {len(nees)} draws: mean NEES {found:.3f} (standard error {unsure:.3f}), {place} its 95 %"
        f" band {band[0]:.3f} to {band[1]:.3f}; joint by joint {joints.min():.2f} to {joints.max():.2f}"
    )


def _outage(spec: RobotSpec, motion: Motion) -> str:
    """How long after 100 ms without a packet the error is what it would have been."""
    begins, silent = round(2.0 / spec.dt), round(OUTAGE_S / spec.dt)
    cut, whole, errors = _estimator(spec, motion), _estimator(spec, motion), []
    for tick, sample, sent in _samples(spec, motion, None):
        heard = {**sample, "encoder": sample["encoder"]._replace(fresh=np.zeros(motion.robots, dtype=bool))}
        now, gone = tick * spec.dt, begins < tick <= begins + silent
        found, usual = cut.step(now, heard if gone else sample, sent).q, whole.step(now, sample, sent).q
        errors.append([np.sqrt(np.mean((x - motion.q[tick - 1]) ** 2)) for x in (found, usual)])
    after = np.array(errors)[begins + silent :]
    worst = np.array(errors)[begins : begins + silent, 0].max()
    recovered = np.flatnonzero(after[:, 0] <= 1.1 * after[:, 1])
    when = (
        f"{1e3 * recovered[0] * spec.dt:.0f} ms after packets are back" if len(recovered) else "never again"
    )
    return f"100 ms without a packet: error up to {1e3 * worst:.1f} mrad, as without it (within 10 %) {when}"


def _cost(spec: RobotSpec, motion: Motion) -> str:
    estimator = _estimator(spec, motion)
    samples = [(tick, _kept(sample), sent) for tick, sample, sent in _samples(spec, motion, None)]
    began = time.perf_counter()
    for tick, sample, sent in samples:
        estimator.step(tick * spec.dt, sample, sent)
    spent = time.perf_counter() - began
    return f"cost: {1e6 * spent / len(samples) / motion.robots:.2f} µs per robot-tick, heat of the windings included"


def _kept(sample: Sample) -> Sample:
    """A sample that outlives the next one."""
    return {
        kind: Packet(t=packet.t.copy(), fresh=packet.fresh.copy(), value=packet.value.copy())
        for kind, packet in sample.items()
    }
