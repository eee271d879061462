import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deploy.safety.safety import Safety
from deploy.simulation import simulate
from deploy.tasks.goal_pool import ReachConfig, goal_pool, sample_pool
from deploy.tasks.reach import Reach
from eval.attack.policy_graph import attack_contract
from robots.errors import RobotError
from robots.models.blocks import BLOCK
from robots.models.fleet import Fleet
from robots.motors.control_mode import ControlMode
from robots.randomness import robot_seed
from support.arm6 import SPEC

CONFIG = ReachConfig()
CENTRE = np.array(SPEC.workspace.centre)
POOL = goal_pool(SPEC, CONFIG)
PERIOD = round(CONFIG.period_s / SPEC.dt)


def task(robots=(0,), seed=1):
    return Reach(SPEC, [robot_seed(seed, robot) for robot in robots])


def step(each, tool, running):
    """One tick with the tools (B, 3) believed to be there."""
    each.achieved[:] = tool
    each.step(running)


def goals(each, count):
    """The next `count` goals of every robot."""
    found = []
    for _ in range(count):
        found.append(each.goal.copy())
        each.reset(np.ones(len(each.goal), dtype=bool))
    return np.array(found)


def test_every_goal_is_in_the_shell_above_the_table_and_accepted_by_safety():
    assert len(POOL.tool) > 5000
    radius = np.linalg.norm(POOL.tool - CENTRE, axis=1)
    assert CONFIG.radius_min <= radius.min()
    assert radius.max() <= CONFIG.radius_max
    assert POOL.tool[:, 2].min() >= CONFIG.z_min
    safety, fleet = Safety(SPEC, Fleet(SPEC, BLOCK, collisions=True)), Fleet(SPEC, BLOCK)
    for start in range(0, 2000, BLOCK):
        q = POOL.q[start : start + BLOCK]
        kinematics = fleet.kinematics(q)
        assert not safety.check_poses(q).any()
        np.testing.assert_array_equal(kinematics.tool_position, POOL.tool[start : start + BLOCK])


@pytest.mark.parametrize("mode", ControlMode)
def test_runtime_sets_goals_and_poses_that_are_safe_with_the_margins_of_its_mode(mode):
    runtime, _ = simulate(SPEC, attack_contract(SPEC, mode), [robot_seed(1, robot) for robot in range(256)])
    found = Safety(SPEC, Fleet(SPEC, 256, collisions=True), mode=mode)
    assert not found.check_poses(runtime.task.start_poses(np.random.default_rng(2))).any()
    pool = goal_pool(SPEC.in_mode(mode), CONFIG)
    assert all((goal == pool.tool).all(axis=1).any() for goal in runtime.task.goal)


def test_goals_cover_four_fifths_of_the_reachable_volume():
    """Which the README says: cells near the table and around the base's axis."""
    all_of_it = goal_pool(SPEC, ReachConfig(z_min=SPEC.workspace.z_min, axis_min=0.0))
    chosen, reachable = (
        len(np.unique(np.floor(pool.tool / CONFIG.cell_m), axis=0)) for pool in (POOL, all_of_it)
    )
    assert 1 - chosen / reachable == pytest.approx(0.2, abs=0.02)


def test_goal_pool_is_deterministic():
    small = ReachConfig(candidates=1600)
    again = sample_pool(SPEC, small)
    for name in ("q", "tool", "cumulative_probability"):
        np.testing.assert_array_equal(getattr(goal_pool(SPEC, small), name), getattr(again, name))


def test_chances_are_a_cumulative_distribution():
    assert (np.diff(POOL.cumulative_probability) > 0).all()
    assert POOL.cumulative_probability[0] > 0
    assert POOL.cumulative_probability[-1] == pytest.approx(1.0, abs=1e-9)


def unevenness(drawn):
    """Chi-square per degree of freedom of each set of points over coarse cells, against what is reachable of each.

    Volume is counted by a grid of 4 cm over a much larger pool, whatever cells the pool itself uses.
    """
    fine, coarse = 0.04, 0.3
    reachable = np.unique(np.floor(goal_pool(SPEC, ReachConfig(candidates=160_000)).tool / fine), axis=0)
    cells, volume = np.unique(np.floor((reachable + 0.5) * fine / coarse), axis=0, return_counts=True)
    cells, volume = cells[volume > 0.3 * volume.max()], volume[volume > 0.3 * volume.max()]
    assert len(cells) >= 8
    for cell in np.floor(drawn / coarse):
        counts = np.array([(cell == each).all(axis=1).sum() for each in cells])
        assert counts.sum() > 0.5 * len(cell)
        expected = volume * counts.sum() / volume.sum()
        yield ((counts - expected) ** 2 / expected).sum() / (len(cells) - 1)


def test_goals_are_uniform_in_volume():
    """As nearly as cells of 10 cm can make it (1 would be exact); joint space alone is several times worse."""
    rng = np.random.default_rng(0)
    chosen = POOL.tool[np.searchsorted(POOL.cumulative_probability, rng.random(4000))]
    unweighted = POOL.tool[rng.integers(len(POOL.tool), size=4000)]
    even, raw = unevenness(np.stack((chosen, unweighted)))
    assert even < 4.5
    assert raw > 3 * even


def test_a_goal_lasts_its_period_and_is_counted_once():
    each = task(range(3))
    first = each.goal.copy()
    for tick in range(1, 2 * PERIOD + 1):
        step(each, np.zeros((3, 3)), np.ones(3, dtype=bool))
        assert each.attempted.tolist() == [tick // PERIOD] * 3
        assert each.ended.all() == (tick % PERIOD == 0)
        assert (each.goal[0] != first[0]).any() == (tick >= PERIOD)
    np.testing.assert_array_equal(each.elapsed, 0)


@pytest.mark.parametrize(("distance", "counts"), [(0.0, 1), (0.0199, 1), (0.0201, 0), (1.0, 0)])
def test_reached_is_within_tolerance_at_the_end(distance, counts):
    each = task(range(2))
    direction = np.array([0.6, 0.0, 0.8])
    goal = each.goal.copy()
    for tick in range(PERIOD):
        step(each, goal + distance * direction if tick == PERIOD - 1 else goal + 5.0, np.ones(2, dtype=bool))
    assert each.reached.tolist() == [counts] * 2
    np.testing.assert_array_equal(each.ended_goal, goal)


def test_reaching_before_the_end_does_not_count():
    each = task()
    goal = each.goal.copy()
    for tick in range(PERIOD):
        step(each, goal if tick < PERIOD - 1 else goal + 0.1, np.ones(1, dtype=bool))
    assert (each.attempted[0], each.reached[0]) == (1, 0)


def test_a_stopped_robot_reaches_nothing():
    each = task(range(2))
    for _ in range(PERIOD):
        step(each, each.goal.copy(), np.array([True, False]))
    assert (each.attempted.tolist(), each.reached.tolist()) == ([1, 1], [1, 0])


@pytest.mark.parametrize(
    "config",
    [{"radius_min": 2.0, "radius_max": 3.0}, {"radius_min": 0.945, "radius_max": 1.2, "candidates": 2000}],
)
def test_a_task_without_a_goal_is_an_error(config):
    with pytest.raises(RobotError, match=r"robot\.toml: of \d+ poses .* no goal can be set"):
        goal_pool(SPEC, ReachConfig(**config))


def test_position_of_nan_is_not_near():
    each = task()
    for _ in range(PERIOD):
        step(each, np.full((1, 3), np.nan), np.ones(1, dtype=bool))
    assert (each.attempted[0], each.reached[0]) == (1, 0)


@settings(max_examples=10)
@given(robots=st.lists(st.integers(0, 999), min_size=1, max_size=6, unique=True), seed=st.integers(0, 2**40))
def test_goals_do_not_depend_on_grouping(robots, seed):
    together = goals(task(robots, seed), 6)
    for place, robot in enumerate(robots):
        np.testing.assert_array_equal(goals(task([robot], seed), 6)[:, 0], together[:, place])


def test_goals_differ_from_robot_to_robot_and_from_time_to_time():
    found = goals(task(range(20)), 20).reshape(-1, 3)
    assert len(np.unique(found, axis=0)) > 380


def test_reset_of_a_subset():
    each, ids = task(range(3)), np.array([False, True, False])
    for _ in range(100):
        step(each, np.zeros((3, 3)), np.ones(3, dtype=bool))
    before = each.save()
    each.reset(ids)
    assert each.elapsed.tolist() == [100, 0, 100]
    np.testing.assert_array_equal(each.goal[~ids], before["goal"][~ids])
    assert (each.goal[1] != before["goal"][1]).any()
    np.testing.assert_array_equal(each.attempted, before["attempted"])


def test_saved_and_restored_goes_on_with_the_same_goals():
    one, other = task(range(3)), task(range(3))
    goals(one, 5)
    other.restore(one.save())
    np.testing.assert_array_equal(goals(other, 10), goals(one, 10))
