"""Errors of the floating-base estimator: simulated quadrupeds, each observed by several noisy IMUs."""

import time
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from deploy.estimation.floating_base.base_faults import GATE
from deploy.estimation.floating_base.base_filter import BaseFilter
from deploy.state import BaseState
from eval.bench.estimation.quadruped import (
    CONTACT_N,
    DT,
    FEET,
    NOISE,
    QuadrupedTruth,
    sensor_packets,
    simulate_quadrupeds,
)
from robots.arrays import Bools, Floats
from robots.randomness import robot_seed
from robots.rotations import matrix, matvec

SEED, MOTIONS, DRAWS, MOTION_S, SETTLED_S = 11, 64, 1024, 5.0, 1.0
SENSOR_SEED = SEED + 1
NEES_PERIOD_S = 0.5
"""s between two samples of one robot's NEES."""
OBSERVABLE = [0, 1, 3, 4, 5]
"""Roll, pitch and velocity among the errors."""


class BaseErrors(NamedTuple):
    """Errors of B estimates.

    Attributes:
        gravity, velocity, angular_velocity: (T, B, 3), at the present tick; m/s, rad/s.
        nees: (T, B) of roll, pitch and velocity. refused: share of the standing feet that the gate refused.
    """

    gravity: Floats
    velocity: Floats
    angular_velocity: Floats
    nees: Floats
    refused: float


def floating(console: Console) -> None:
    """Print errors with and without feet, consistency over many draws, and cost."""
    truth = simulate_quadrupeds([robot_seed(SEED, robot) for robot in range(MOTIONS)], MOTION_S)
    with_feet, without = (
        [estimate_base(truth, first, MOTIONS, feet=feet) for first in range(0, DRAWS, MOTIONS)]
        for feet in (True, False)
    )
    console.print(_error_table(trotting(truth), with_feet, without))
    refused = np.mean([errors.refused for errors in with_feet])
    console.print(f"{_consistency(with_feet)}; {100 * refused:.2f} % of the feet refused")
    console.print(_cost(truth))


def _error_table(trots: Bools, with_feet: list[BaseErrors], without: list[BaseErrors]) -> Table:
    table = Table(
        *("", "tilt, mrad", "velocity, mm/s", "angular velocity, mrad/s", "mean NEES"),
        title=f"RMSE of {DRAWS} draws on {MOTIONS} motions of a quadruped over {MOTION_S - SETTLED_S:g} s; NEES of 5",
    )
    for name, robots in (("stands, sways, crouches", ~trots), ("trots", trots)):
        for label, errors in ((name, with_feet), (f"{name}: IMU only", without)):
            table.add_row(label, *_figures(errors, robots))
    return table


def trotting(truth: QuadrupedTruth) -> Bools:
    """(M,) Robots whose feet are in the air for more than a fifth of the time."""
    return np.asarray(np.mean(truth.force > CONTACT_N, axis=(0, 2)) < 0.8)


def estimate_base(truth: QuadrupedTruth, first: int, robots: int, *, feet: bool) -> BaseErrors:
    """Estimate B draws of sensors, from draw `first` on, on the M motions in turn; dead reckoning without feet."""
    seeds = [robot_seed(SENSOR_SEED, robot) for robot in range(first, first + robots)]
    motion, rows = np.arange(robots) % truth.gyro.shape[1], []
    R = matrix(truth.quat_wxyz.reshape(-1, 4)).reshape(*truth.gyro.shape, 3)
    up, velocity = R[..., 2, :], (R.swapaxes(2, 3) @ truth.velocity_in_world[..., None])[..., 0]
    base = BaseFilter(NOISE, DT, robots, FEET)
    for t, imu, legs in sensor_packets(truth, NOISE, seeds):
        state = base.step(t, imu, legs._replace(stance=legs.stance & feet))
        if t < SETTLED_S:
            continue
        now, sampled = (round(t / DT), motion), (np.rint(base.t_sample / DT).astype(int), motion)
        errors = (state.gravity + up[now], state.velocity_in_base - velocity[now])
        nees = _nees(base, up[sampled], velocity[sampled])
        rows.append((*errors, state.angular_velocity - truth.gyro[now], nees, _refused(state)))
    gravity, speed, turning, nees, refused = (np.array(column) for column in zip(*rows, strict=True))
    return BaseErrors(gravity, speed, turning, nees, float(refused.mean()))


def _nees(base: BaseFilter, up: Floats, velocity: Floats) -> Floats:
    """(B,) squared errors of roll, pitch and velocity by their joint covariance: mean 5 if consistent.

    Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), sec. 5.4.
    """
    tilted = matvec(matrix(base.quat_wxyz), up)
    error = np.stack([tilted[:, 1], -tilted[:, 0], *(velocity - base.velocity).T], axis=1)
    P = base.P[:, OBSERVABLE][:, :, OBSERVABLE]
    return np.asarray((error * np.linalg.solve(P, error[..., None])[..., 0]).sum(axis=1))


def _refused(state: BaseState) -> float:
    nis = (state.innovation**2).sum(axis=2)
    return float((nis > GATE).sum() / max(1, (nis > 0).sum()))


def _figures(draws: list[BaseErrors], robots: Bools) -> list[str]:
    errors = ([getattr(one, name)[:, robots] for one in draws] for name in BaseErrors._fields[:3])
    rmse = (1e3 * rms(np.concatenate(error, axis=1)) for error in errors)
    nees = np.mean([one.nees[:, robots] for one in draws])
    return [*(f"{value:.1f}" for value in rmse), f"{nees:.2f}"]


def rms(error: Floats) -> float:
    """Root of the mean squared length of (..., 3)."""
    return float(np.sqrt(np.mean((error**2).sum(axis=-1))))


def _consistency(draws: list[BaseErrors]) -> str:
    """Return a line on the spread of NEES over draws.

    Slip is neither white nor small at touch-down, so no band of χ² holds here.
    """
    nees = np.concatenate([one.nees[:: round(NEES_PERIOD_S / DT)] for one in draws], axis=1).mean(axis=0)
    low, high = np.quantile(nees, (0.05, 0.95))
    return (
        f"consistency over {len(nees)} draws: mean NEES {nees.mean():.2f} of 5,"
        f" 90 % of the draws from {low:.1f} to {high:.1f}"
    )


def _cost(truth: QuadrupedTruth) -> str:
    spent = []
    for robots in (MOTIONS, 1):
        base = BaseFilter(NOISE, DT, robots, FEET)
        seeds = [robot_seed(SENSOR_SEED, robot) for robot in range(robots)]
        packets = list(sensor_packets(truth, NOISE, seeds))
        began = time.perf_counter()
        for t, imu, legs in packets:
            base.step(t, imu, legs)
        spent.append(1e6 * (time.perf_counter() - began) / len(packets) / robots)
    return f"cost: {spent[0]:.1f} µs per robot-tick of {MOTIONS} robots, {spent[1]:.0f} µs of one robot"
