"""The simulated distance sensor, and what a policy reads where a sensor says nothing."""

import numpy as np
import pytest

from deploy.backends.sim.sensor_faults import Failure, Fault
from deploy.simulation import simulate
from deploy.sources.readings import SILENT_S
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.arm6 import copy_of_arm
from support.contracts import arm_contract, term
from support.deploy.exact_robots import exact_runtime, observe

RANGE = 1.5
DISTANCE = f"""[sensors.distance]
unit = "m"
sites = ["tool"]
rate_hz = 30
resolution = 0.001
range = {RANGE}
noise = 0.045
bias = 0.0
drift = 0.0
drift_per_k = 0.0
delay_s = 0.03
loss = 0.01
source = "estimate: 3 % of its range"

[sensors.goal]"""
SOURCES = ("goal_distance", "tool_position", "goal_position", "tool_force")


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    return load_robot(copy_of_arm(tmp_path_factory.mktemp("far"), toml=[(r"\[sensors\.goal\]", DISTANCE)]))


@pytest.fixture
def runtime(spec):
    """An exact arm at rest that has seen its goal."""
    runtime = exact_runtime(spec, arm_contract, SOURCES)
    observe(runtime, 10)
    return runtime


def reading(runtime, goal, ticks=15):
    """What the policy reads of a goal that stays at one place."""
    runtime.robot.goal_source = lambda: np.array([goal])
    return observe(runtime, ticks)


def test_the_distance_is_that_of_the_goal(runtime):
    tool = runtime.robot.truth().tool_position[0]
    for away in ((0.1, 0.0, 0.05), (0.0, -0.2, 0.1), (0.3, 0.2, 0.0)):
        seen = reading(runtime, tool + away)
        np.testing.assert_allclose(seen["goal_distance"], np.linalg.norm(away), atol=0.003)


def test_a_goal_that_can_be_touched_does_not_hide_itself(tmp_path):
    """The beam ends on the goal's own sphere, from every side and at every distance."""
    touch = '[[may_touch]]\nbodies = ["wrist_3_link", "goal"]\n\n' + DISTANCE
    spec = load_robot(copy_of_arm(tmp_path, toml=[(r"\[sensors\.goal\]", touch)]))
    runtime, rng = exact_runtime(spec, arm_contract, SOURCES), np.random.default_rng(0)
    tool = runtime.robot.truth().tool_position[0]
    for away in rng.uniform([0.1, -0.3, -0.1], [0.4, 0.3, 0.05], (60, 3)):
        reading(runtime, tool + away, 3)
        assert runtime.robot.distance.value[0, 0] == pytest.approx(np.linalg.norm(away), abs=1e-3)


def test_a_moving_arm_measures_all_the_way(spec):
    """The beam is turned with the link."""
    runtime = exact_runtime(spec, arm_contract, SOURCES)
    observe(runtime, 10)
    assert not runtime.arm(np.ones(1, dtype=bool)).any()
    goal = runtime.robot.truth().tool_position[0] + [0.25, 0.15, -0.05]
    runtime.robot.goal_source = lambda: goal[None]
    read = []
    for _ in range(60):
        observe(runtime, 1, np.array([[0.4, 0.1, 0.0, 0.3, 0.2, 0.4]]))
        truth = np.linalg.norm(runtime.robot.truth().tool_position - goal)
        assert runtime.robot.distance.value[0, 0] == pytest.approx(truth, abs=1e-9)
        read.append(truth)
    assert np.ptp(read) > 0.1


@pytest.mark.parametrize("where", ["behind the forearm", "below the table"])
def test_a_body_in_between_leaves_no_reading(runtime, where):
    """The policy then reads the range."""
    model, data = runtime.robot.plant.batch.get_model(0), runtime.robot.plant.batch.get_data(0)
    tool = runtime.robot.truth().tool_position[0]
    goal = tool * [1.0, 1.0, 0.0] - [0.0, 0.0, 0.05]
    if where == "behind the forearm":
        forearm = data.geom_xpos[model.geom("forearm").id]
        goal = forearm + 0.3 * (forearm - tool)
    seen = reading(runtime, goal)
    assert np.isnan(runtime.robot.distance.value).all()
    assert seen["goal_distance"] == pytest.approx(RANGE)
    np.testing.assert_allclose(seen["goal_position"][0], goal, atol=0.002)  # the camera sees it


def test_a_settled_goal_is_read_at_once(runtime):
    goal = runtime.robot.truth().tool_position[0] + [0.1, 0.2, 0.1]
    runtime.robot.goal_source = lambda: goal[None]
    runtime.robot.settle_goal(np.ones(1, dtype=bool))
    seen = observe(runtime, 1)
    assert seen["goal_distance"] == pytest.approx(np.linalg.norm([0.1, 0.2, 0.1]), abs=0.003)
    np.testing.assert_allclose(seen["goal_position"][0], goal, atol=0.002)


def test_a_goal_beyond_the_range_reads_as_the_range(runtime):
    assert reading(runtime, [2.0, 0.0, 2.0])["goal_distance"] == pytest.approx(RANGE)


def test_without_goal_the_reading_is_the_range(runtime):
    assert reading(runtime, [np.nan] * 3)["goal_distance"] == pytest.approx(RANGE)


def test_noise_is_a_share_of_the_range(spec):
    runtime = exact_runtime(spec, arm_contract, SOURCES, {"sensors.noise": 1.0})
    goal = runtime.robot.truth().tool_position[0] + [0.3, 0.0, 0.1]
    runtime.robot.goal_source = lambda: goal[None]
    observe(runtime, 10)
    read = [observe(runtime, 2)["goal_distance"][0, 0] for _ in range(300)]
    assert np.std(read) / RANGE == pytest.approx(0.03, rel=0.15)


def test_a_silent_sensor_holds_its_last_reading_for_a_second(spec):
    contract = arm_contract(
        robot_digest=spec.digest, observation=(term("goal_distance", 1), term("tool_force", 3))
    )
    faults = [
        Fault(robot=0, sensor=kind, what=Failure.OFF, begins=100, ends=10_000)
        for kind in ("distance", "force")
    ]
    runtime = simulate(spec, contract, [robot_seed(1, 0)], faults=faults)[0]
    for _ in range(25):
        observe(runtime)
    before = observe(runtime)
    assert 0.0 < before["goal_distance"][0, 0] < 1.4 / 1.5
    observe(runtime, round(0.5 * SILENT_S * 50))
    held = observe(runtime)
    assert held["tool_force"].any()
    observe(runtime, round(SILENT_S * 50))
    silent = observe(runtime)
    assert silent["goal_distance"] == pytest.approx(RANGE / 1.5)  # of the term's scale
    assert not silent["tool_force"].any()


def test_one_dead_channel_reads_zero_and_the_policy_stays_finite(spec):
    contract = arm_contract(
        robot_digest=spec.digest, observation=(term("tool_force", 3), term("motor_current", 6))
    )
    faults = [
        Fault(robot=0, sensor=kind, what=Failure.OFF, channel=1, begins=100, ends=200)
        for kind in ("force", "current")
    ]
    runtime = simulate(spec, contract, [robot_seed(1, 0)], faults=faults)[0]
    for _ in range(35):
        seen = observe(runtime)
    assert seen["tool_force"][0, 1] == seen["motor_current"][0, 1] == 0.0
    assert seen["tool_force"][0, [0, 2]].all()
    for _ in range(25):
        seen = observe(runtime)
    assert seen["tool_force"][0, 1] != 0.0


def test_the_sensor_is_saved_and_restored(runtime):
    state, body = runtime.save(), runtime.robot.save()
    first = [observe(runtime)["goal_distance"] for _ in range(10)]
    runtime.restore(state)
    runtime.robot.restore(body)
    np.testing.assert_array_equal([observe(runtime)["goal_distance"] for _ in range(10)], first)
