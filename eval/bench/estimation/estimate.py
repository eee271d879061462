"""Joint estimation errors: the same motions through the same simulated bus, with and without the estimator.

Robots are recorded under the policy once, then replayed through encoders of several noises.
"""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import stats

from deploy.state import Packet, Sample
from deploy.telemetry.output_files import replacing
from eval.bench.estimation.encoder_plot import draw_encoder
from eval.bench.estimation.recorded_motion import (
    SHARD,
    JointEstimates,
    Motion,
    estimate_motion,
    initial_estimator,
    record_motion,
    replay,
)
from robots.arrays import Floats
from robots.spec import RobotSpec

ROBOTS, TABLE_ROBOTS, SETTLED_S = 1024, 256, 1.0
"""Robots of the consistency test, robots of the table, s left out at the start."""
NOISES = (None, 0.0005, 0.001, 0.002, 0.005, 0.01)
"""rad, the same for all robots; None: as drawn for each."""
OUTAGE_START_S, OUTAGE_S = 2.0, 0.1
COLUMNS = (
    *("encoder noise", "q: raw", "estimated", "qd: differenced", "estimated", "÷"),
    *("delay left in q: raw", "estimated"),
)


def estimate(spec: RobotSpec, policy: Path, console: Console, picture: Path | None = None) -> None:
    """Print errors by noise, consistency over draws, recovery from an outage, cost; draw `picture` if given."""
    motions = [record_motion(spec, policy, first) for first in range(0, ROBOTS, SHARD)]
    tabled = motions[: TABLE_ROBOTS // SHARD]
    console.print(_error_table(spec, tabled))
    console.print(consistency(spec, motions))
    console.print(outage(spec, tabled[0]))
    console.print(_cost(spec, tabled[0]))
    if picture is not None:
        with replacing(picture) as file:
            draw_encoder(spec, tabled[0], estimate_motion(spec, tabled[0], None), file)


def _error_table(spec: RobotSpec, motions: list[Motion]) -> Table:
    title = f"RMSE of {len(motions) * SHARD} robots, mrad and mrad/s; delays and losses as drawn"
    table = Table(*COLUMNS, title=title)
    for noise in NOISES:
        name = "as drawn" if noise is None else f"{1e3 * noise:g} mrad"
        table.add_row(name, *error_row(spec, motions, noise))
    return table


def error_row(spec: RobotSpec, motions: list[Motion], noise: float | None) -> list[str]:
    """Return a row of the table: RMS errors, ratio of the speed errors, delays left in the angle."""
    settled = round(SETTLED_S / spec.dt)
    estimates = [estimate_motion(spec, motion, noise) for motion in motions]

    def joined(records: Sequence[Motion | JointEstimates], name: str) -> Floats:
        return np.concatenate([getattr(record, name)[settled:] for record in records], axis=1)

    q, qd = (joined(motions, name) for name in ("q", "qd"))
    raw, differenced, q_hat, qd_hat = (joined(estimates, name) for name in ("raw", "differenced", "q", "qd"))
    pairs = (raw, q), (q_hat, q), (differenced, qd), (qd_hat, qd)
    rmse = [1e3 * np.sqrt(np.mean((a - b) ** 2)) for a, b in pairs]
    # The error of a late angle is proportional to the speed: the slope of error over speed is the delay left.
    left = [1e3 * np.sum((q - a) * qd) / np.sum(qd**2) for a in (raw, q_hat)]
    return [*(f"{value:.2f}" for value in rmse), f"{rmse[3] / rmse[2]:.3f}", *(f"{ms:.2f} ms" for ms in left)]


def consistency(spec: RobotSpec, motions: list[Motion]) -> str:
    """Return a line on the NEES of every draw, averaged over its motion.

    The band is that of independent draws sampled once (Bar-Shalom, 5.4.2). One moment per draw would do if errors were
    Gaussian. They are not, and the mean would deviate twice as much.
    """
    settled = round(SETTLED_S / spec.dt)
    nees = np.concatenate(
        [estimate_motion(spec, motion, None).nees[settled:].mean(axis=0) for motion in motions]
    )
    band = np.array(stats.chi2.interval(0.95, 2 * nees.size)) / nees.size
    mean, joints = nees.mean(), nees.mean(axis=0)
    error = nees.mean(axis=1).std(ddof=1) / np.sqrt(len(nees))
    place = "inside" if band[0] <= mean <= band[1] else "outside"
    return (
        f"consistency over {len(nees)} draws: mean NEES {mean:.3f} (standard error {error:.3f}), {place} its 95 %"
        f" band {band[0]:.3f} to {band[1]:.3f}; joint by joint {joints.min():.2f} to {joints.max():.2f}"
    )


def outage(spec: RobotSpec, motion: Motion) -> str:
    """Return a line on the error during 100 ms without packets, and the time to recover from it."""
    start = round(OUTAGE_START_S / spec.dt)
    end = start + round(OUTAGE_S / spec.dt)
    interrupted, reference = initial_estimator(spec, motion), initial_estimator(spec, motion)
    rows = []
    for tick, sample, sent in replay(spec, motion, None):
        lost = {**sample, "encoder": sample["encoder"]._replace(fresh=np.zeros(motion.robots, dtype=bool))}
        t, delivered = tick * spec.dt, lost if start < tick <= end else sample
        estimates = interrupted.step(t, delivered, sent).q, reference.step(t, sample, sent).q
        rows.append([np.sqrt(np.mean((q - motion.q[tick - 1]) ** 2)) for q in estimates])
    errors = np.array(rows)
    worst, after = errors[start:end, 0].max(), errors[end:]
    recovered = np.flatnonzero(after[:, 0] <= 1.1 * after[:, 1])
    when = f"{1e3 * recovered[0] * spec.dt:.0f} ms after packets return" if len(recovered) else "never"
    return f"100 ms without a packet: error up to {1e3 * worst:.1f} mrad, within 10 % of normal {when}"


def _cost(spec: RobotSpec, motion: Motion) -> str:
    estimator = initial_estimator(spec, motion)
    samples = [(tick, _copied(sample), sent) for tick, sample, sent in replay(spec, motion, None)]
    began = time.perf_counter()
    for tick, sample, sent in samples:
        estimator.step(tick * spec.dt, sample, sent)
    spent = time.perf_counter() - began
    return f"cost: {1e6 * spent / len(samples) / motion.robots:.2f} µs per robot-tick, winding heat included"


def _copied(sample: Sample) -> Sample:
    return {
        kind: Packet(t=packet.t.copy(), fresh=packet.fresh.copy(), value=packet.value.copy())
        for kind, packet in sample.items()
    }
