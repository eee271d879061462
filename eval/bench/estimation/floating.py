"""What the estimator of a floating base is worth: a quadruped that walks in physics, watched by many bad IMUs."""

import time
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from deploy.estimation.floating_base.base_divergence import GATE
from deploy.estimation.floating_base.base_filter import BaseFilter
from deploy.estimation.rotations import matrix, matvec
from deploy.state import BaseState
from eval.bench.estimation.quadruped import CONTACT_N, DT, FEET, NOISE, Truth, move, watch
from robots.arrays import Bools, Floats
from robots.randomness import robot_seed

SEED, MOTIONS, DRAWS, MOVED_S, SETTLED_S = 11, 64, 1024, 5.0, 1.0
WATCHERS = SEED + 1
APART_S = 0.5
"""s between two looks at one robot's NEES."""
KNOWN = [0, 1, 3, 4, 5]
"""Roll, pitch and velocity among the errors."""


class Followed(NamedTuple):
    """Errors of B estimates, now: (T, B, 3), `nees` (T, B) of roll, pitch and velocity, `refused` of the feet."""

    gravity: Floats
    velocity: Floats
    angular_velocity: Floats
    nees: Floats
    refused: float


def floating(console: Console) -> None:
    """Errors with and without feet, consistency over many draws, and the cost."""
    truth = move([robot_seed(SEED, robot) for robot in range(MOTIONS)], MOVED_S)
    with_feet, without = (
        [follow(truth, first, MOTIONS, feet=feet) for first in range(0, DRAWS, MOTIONS)]
        for feet in (True, False)
    )
    # Who trots has its feet in the air for a good part of the time.
    trots = np.mean(truth.force > CONTACT_N, axis=(0, 2)) < 0.8
    table = Table(
        *("", "tilt, mrad", "velocity, mm/s", "angular velocity, mrad/s", "mean NEES"),
        title=f"RMSE of {DRAWS} draws on {MOTIONS} motions of a quadruped over {MOVED_S - SETTLED_S:g} s; NEES of 5",
    )
    for name, robots in (("stands, sways, crouches", ~trots), ("trots", trots)):
        for label, found in ((name, with_feet), ("the same, IMU alone", without)):
            table.add_row(label, *_figures(found, robots))
    console.print(table)
    refused = np.mean([one.refused for one in with_feet])
    console.print(f"{_consistency(with_feet)}; {100 * refused:.2f} % of the feet refused")
    console.print(_cost(truth))


def follow(truth: Truth, first: int, robots: int, *, feet: bool) -> Followed:
    """B watchers on the M motions, in turn, from the `first` on; without feet it is dead reckoning."""
    seeds = [robot_seed(WATCHERS, robot) for robot in range(first, first + robots)]
    who, rows = np.arange(robots) % truth.gyro.shape[1], []
    R = matrix(truth.quat_wxyz.reshape(-1, 4)).reshape(*truth.gyro.shape, 3)
    up, velocity = R[..., 2, :], (R.swapaxes(2, 3) @ truth.velocity_in_world[..., None])[..., 0]
    base = BaseFilter(NOISE, DT, robots, FEET)
    for t, imu, legs in watch(truth, NOISE, seeds):
        state = base.step(t, imu, legs._replace(stance=legs.stance & feet))
        if t < SETTLED_S:
            continue
        now, then = (round(t / DT), who), (np.rint(base.t_sample / DT).astype(int), who)
        errors = (state.gravity + up[now], state.velocity_in_base - velocity[now])
        nees = _nees(base, up[then], velocity[then])
        rows.append((*errors, state.angular_velocity - truth.gyro[now], nees, _refused(state)))
    gravity, speed, turning, nees, refused = (np.array(column) for column in zip(*rows, strict=True))
    return Followed(gravity, speed, turning, nees, float(refused.mean()))


def _nees(base: BaseFilter, up: Floats, velocity: Floats) -> Floats:
    """(B,) squared errors of roll, pitch and velocity by their joint covariance: 5 on average if it is true.

    Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), sec. 5.4.
    """
    leans = matvec(matrix(base.quat_wxyz), up)
    error = np.stack([leans[:, 1], -leans[:, 0], *(velocity - base.velocity).T], axis=1)
    P = base.P[:, KNOWN][:, :, KNOWN]
    return np.asarray((error * np.linalg.solve(P, error[..., None])[..., 0]).sum(axis=1))


def _refused(state: BaseState) -> float:
    """Share of the standing feet that the gate left out."""
    nis = (state.innovation**2).sum(axis=2)
    return float((nis > GATE).sum() / max(1, (nis > 0).sum()))


def _figures(found: list[Followed], robots: Bools) -> list[str]:
    """A row of the table."""
    errors = ([getattr(one, name)[:, robots] for one in found] for name in Followed._fields[:3])
    rmse = (1e3 * rms(np.concatenate(error, axis=1)) for error in errors)
    nees = np.mean([one.nees[:, robots] for one in found])
    return [*(f"{value:.1f}" for value in rmse), f"{nees:.2f}"]


def rms(error: Floats) -> float:
    """Root of the mean squared length of (..., 3)."""
    return float(np.sqrt(np.mean((error**2).sum(axis=-1))))


def _consistency(found: list[Followed]) -> str:
    """The spread is that of draws: slip is neither white nor small where a foot lands, so no band of χ² holds here."""
    nees = np.concatenate([one.nees[:: round(APART_S / DT)] for one in found], axis=1).mean(axis=0)
    low, high = np.quantile(nees, (0.05, 0.95))
    return (
        f"consistency over {len(nees)} draws: mean NEES {nees.mean():.2f} of 5,"
        f" nine draws of ten from {low:.1f} to {high:.1f}"
    )


def _cost(truth: Truth) -> str:
    spent = []
    for robots in (MOTIONS, 1):
        base = BaseFilter(NOISE, DT, robots, FEET)
        packets = list(watch(truth, NOISE, [robot_seed(WATCHERS, robot) for robot in range(robots)]))
        began = time.perf_counter()
        for t, imu, legs in packets:
            base.step(t, imu, legs)
        spent.append(1e6 * (time.perf_counter() - began) / len(packets) / robots)
    return f"cost: {spent[0]:.1f} µs per robot-tick of {MOTIONS} robots, {spent[1]:.0f} µs of one robot"
