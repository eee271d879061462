"""Monitors of the whole robot: tool, singularity, contacts, power, observation and action."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from deploy.state import Mode
from robots.models.fleet import Fleet
from support.arm6 import SPEC, arm_judge
from support.eval.judges import (
    CENTRE,
    HOME,
    LIMITS,
    SIZE,
    SPACE,
    TORQUE_MAX,
    Bench,
)

HAIR = 1e-6


@pytest.mark.parametrize(("by", "fires"), [(HAIR, True), (-HAIR, False)])
@pytest.mark.parametrize(
    ("name", "field", "row"),
    [
        ("workspace", "tool_position", lambda by: CENTRE - np.array([0.0, SPACE.radius_max + by, 0.0])),
        ("workspace", "tool_position", lambda by: [0.3, 0.1, SPACE.z_min - by]),
        ("tool_speed", "tool_velocity", lambda by: [0.0, 0.0, -SPACE.tool_speed_max - by]),
        ("contact_force", "contact_n", lambda by: LIMITS.contact_n + by),
    ],
)
def test_tool_limits(name, field, row, by, fires):
    bench = Bench(robots=2)
    getattr(bench.truth, field)[1] = row(by)
    bench.step()
    assert bench.fired() == ({name} if fires else set())
    assert bench.judge.counts().bad_draws(name) == int(fires)


def beside_singularity(w):
    """Home with its wrist bent so far that det J, as Pinocchio computes it, is `w`."""
    fleet, low, high = Fleet(SPEC, 1), HOME.copy(), HOME.copy()
    high[4] *= -1
    while abs(low[4] - high[4]) > 1e-12:
        middle = (low + high) / 2
        kinematics = fleet.kinematics(middle[None])
        low, high = (middle, high) if kinematics.manipulability()[0] > w else (low, middle)
    return low


@pytest.mark.parametrize(
    ("share", "load"), [(1 - HAIR, 1 + HAIR), (1 + HAIR, 1 - HAIR), (4.0, 0.25), (1e-4, 1e3), (-300, 1e3)]
)
def test_singularity_limit_on_both_sides(share, load):
    bench = Bench(robots=3)
    bench.truth.q[1] = bench.sent[1] = beside_singularity(share * LIMITS.manipulability)
    bench.step()
    counts = bench.judge.counts()
    columns = counts.columns("singularity")
    assert bench.fired() - {"position_soft", "position_hard"} == ({"singularity"} if load > 1 else set())
    assert counts.worst[1, columns] == pytest.approx(load, rel=1e-8)
    assert counts.limits[columns] == pytest.approx(1 / LIMITS.manipulability)
    assert (counts.worst[::2, columns] < 0.01).all()  # at home


@pytest.mark.parametrize("what", [np.nan, np.inf])
@pytest.mark.parametrize(
    ("mode", "then", "powered", "fires"),
    [
        (Mode.RUNNING, Mode.RUNNING, True, True),
        (Mode.ARMING, Mode.RUNNING, True, True),
        (Mode.RUNNING, Mode.STOPPING, True, False),
        (Mode.STOPPING, Mode.STOPPING, True, False),
        (Mode.DISARMED, Mode.RUNNING, False, False),
    ],
)
def test_non_finite_policy_output_must_stop_by_the_next_tick(what, mode, then, powered, fires):
    bench = Bench(robots=2)
    bench.action[1, 3] = what
    bench.mode[:], bench.powered[:] = mode, powered
    bench.step()
    assert bench.fired() == set()
    bench.action, bench.mode[:], bench.powered[:] = None, then, True
    bench.step(3)
    counts = bench.judge.counts()
    assert bench.fired() == ({"action_finite"} if fires else set())
    assert counts.bad_ticks[:, counts.columns("action_finite")].ravel().tolist() == [0, int(fires)]


def test_self_collision():
    bench = Bench(robots=2)
    bench.truth.self_collision[0] = True
    bench.step()
    assert bench.fired() == {"self_collision"}


@pytest.mark.parametrize(("by", "fires"), [(HAIR, True), (-HAIR, False)])
def test_robot_power_is_the_sum_of_joint_powers(by, fires):
    bench = Bench()
    bench.truth.qd[:], bench.truth.tau[:] = 1.0, [100.0, 150.0, 80.0, 20.0, 0.0, LIMITS.power_w - 350.0 + by]
    bench.truth.tau[0, 5] -= 0.0
    bench.step()
    assert ("robot_power" in bench.fired()) == fires
    bench.truth.qd[0, 1] = -1.0
    before = bench.judge.counts().bad_ticks[:, bench.judge.counts().columns("robot_power")].sum()
    bench.step()
    counts = bench.judge.counts()
    assert counts.bad_ticks[:, counts.columns("robot_power")].sum() == before


@pytest.mark.parametrize("which", range(SIZE))
@pytest.mark.parametrize(("by", "fires"), [(1e-3, True), (-1e-3, False), (np.nan, True)])
def test_observation_outside_training_statistics_fires(which, by, fires):
    bench = Bench(robots=2)
    bench.observation[1, which] += 0.5 * (LIMITS.deviations + by)
    bench.step()
    assert bench.fired() == ({"observation"} if fires else set())
    bench.mode[:] = Mode.HOLDING
    bench.step()
    counts = bench.judge.counts()
    assert counts.bad_ticks.sum() == int(fires)
    assert counts.limits[counts.columns("observation")].tolist() == [LIMITS.deviations]


def test_observations_are_not_judged_without_training_statistics():
    bench = Bench()
    bench.judge = arm_judge(TORQUE_MAX, 1)
    bench.observation[:] = 1e9
    bench.step(3)
    counts = bench.judge.counts()
    assert bench.fired() == set()
    assert np.isinf(counts.limits[counts.columns("observation")])
    assert counts.worst[:, counts.columns("observation")].max() == 0.0
