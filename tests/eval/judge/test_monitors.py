"""A monitor that is declared here, outside the catalogue; and robots without the capabilities of some monitors."""

import re

import numpy as np
import pytest

from deploy.tasks.reach import Reach
from eval.judge.judge import Judge
from eval.judge.monitor import JointMonitor, Monitor
from eval.judge.monitors import MONITORS
from robots.errors import ConfigError
from robots.spec import load_robot
from support.arm6 import NO_CLEARANCE, NO_TOOL, NO_WORKSPACE, SPEC, arm_judge, copy_of_arm
from support.eval.judges import DT, OBSERVED, TORQUE_MAX, Bench, N, feed, random_series

BRAKING = JointMonitor(
    name="braking",
    unit="W",
    hard=True,
    meaning="true mechanical power that a joint takes",
    limit=lambda robot: 0.5 * robot.limits.motor_array("power_w", robot.spec),
    value=lambda window: np.minimum(window.joint_power, 0.0),
)
TOOL_ACCELERATION = Monitor(
    name="tool_acceleration",
    unit="m/s²",
    hard=False,
    meaning="1st backward difference of the true height's speed",
    limit=lambda robot: 9.81,
    value=lambda window: window.now.tool_velocity[..., 2] - window.before.tool_velocity[..., 2],
    needs=frozenset({"tool"}),
    difference_order=1,
)
KNEELING = Monitor(
    name="kneeling",
    unit="rad",
    hard=True,
    meaning="a monitor of robots that the arm is not one of",
    limit=lambda robot: robot.spec.base.tilt_max_rad,
    value=lambda window: window.now.tilt / 0.0,
    needs=frozenset({"floating_base"}),
)
ALL = (KNEELING, TOOL_ACCELERATION, *MONITORS, BRAKING)


def bench(robots):
    found = Bench(robots=robots)
    found.judge = arm_judge(TORQUE_MAX, robots, observed=OBSERVED, monitors=ALL)
    return found


def test_a_monitor_from_outside_is_judged_counted_and_logged():
    found = bench(robots=2)
    found.truth.qd[1, 3], found.truth.tau[1, 3] = 1.0, -20.0 * (1 + 1e-6)
    found.step(3)
    found.truth.tool_velocity[0, 2] = -9.81 * DT * (1 + 1e-6)
    found.step(5)
    counts = found.judge.counts()
    assert {event.monitor.name for event in counts.log()} == {"braking", "tool_acceleration"}
    (braking,) = (event for event in counts.log() if event.monitor.name == "braking")
    assert (braking.robot, braking.joint, braking.start, braking.ticks) == (1, SPEC.joint_names[3], 0, 8)
    assert (braking.limit, braking.worst) == (20.0, pytest.approx(1 + 1e-6))
    (step,) = (event for event in counts.log() if event.monitor.name == "tool_acceleration")
    assert (step.robot, step.joint, step.start, step.ticks) == (0, None, 3, 1)
    assert counts.hard_events().tolist() == [0, 1]
    assert counts.bad_draws("braking") == counts.bad_draws() == 1
    assert counts.by_monitor().shape == (2, len(MONITORS) + 3)


def test_a_robot_has_the_monitors_whose_needs_it_meets():
    found = bench(robots=1)
    found.step()
    counts = found.judge.counts()
    names = {monitor.name for monitor in counts.monitors}
    assert names - {monitor.name for monitor in MONITORS} == {"braking", "tool_acceleration"}
    assert np.isinf(counts.limits[counts.columns("kneeling")])
    assert counts.worst[:, counts.columns("kneeling")] == 0


def test_it_changes_nothing_of_all_others():
    ticks, series = 300, random_series(300, 2, seed=12)
    usual, more = (arm_judge(TORQUE_MAX, 2, observed=OBSERVED, monitors=each) for each in (MONITORS, ALL))
    for judge in (usual, more):
        feed(judge, series, range(ticks))
    a, b = usual.counts(), more.counts()
    for monitor in MONITORS:
        here, there = a.columns(monitor.name), b.columns(monitor.name)
        np.testing.assert_array_equal(a.bins[here], b.bins[there])
        for name in ("worst", "events", "bad_ticks"):
            np.testing.assert_array_equal(getattr(a, name)[:, here], getattr(b, name)[:, there])
    assert len(b.limits) == len(a.limits) + N + 2


def test_two_monitors_of_one_name_are_refused():
    with pytest.raises(ConfigError, match="'braking' 2 times"):
        arm_judge(TORQUE_MAX, 1, monitors=(*MONITORS, BRAKING, BRAKING))


WITHOUT_MANIPULABILITY = (("singularity = 0.0005", ""),)


@pytest.mark.parametrize(
    ("edits", "missing"),
    [
        (NO_WORKSPACE, {"workspace", "tool_speed"}),
        (WITHOUT_MANIPULABILITY, {"singularity"}),
        (NO_TOOL, {"workspace", "tool_speed", "singularity"}),
        (NO_CLEARANCE, {"self_collision"}),
    ],
)
def test_an_arm_without_a_capability_is_judged_without_its_monitors(tmp_path, edits, missing):
    folder, series = copy_of_arm(tmp_path, toml=edits), random_series(300, 2, seed=13)
    path = folder / "limits.toml"
    if "singularity" in missing:
        path.write_text(re.sub("manipulability = .*\n", "", path.read_text()))
    usual, less = (
        Judge(spec, TORQUE_MAX, 2, criterion=Reach.success_criterion(SPEC), observed=OBSERVED)
        for spec in (SPEC, load_robot(folder))
    )
    for judge in (usual, less):
        feed(judge, series, range(300))
    a, b = usual.counts(), less.counts()
    assert {monitor.name for monitor in a.monitors} - {monitor.name for monitor in b.monitors} == missing
    for monitor in MONITORS:
        columns = a.columns(monitor.name)
        judged = monitor.name not in missing and monitor in a.monitors
        assert bool(a.worst[:, columns].any()) == (monitor in a.monitors)
        wanted = a.worst[:, columns] if judged else np.zeros_like(a.worst[:, columns])
        np.testing.assert_array_equal(b.worst[:, columns], wanted)
        np.testing.assert_array_equal(np.isfinite(b.limits[columns]), judged)
