import numpy as np
import pytest
from scipy.spatial import cKDTree

from deploy.policy.compatibility import mismatches
from deploy.tasks.planar_reach import PlanarReach
from deploy.tasks.task import tasks_of
from robots.errors import RobotError
from robots.models.fleet import Fleet
from robots.models.planar_chain import PlanarChain
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.arm6 import SPEC
from support.contracts import arm_contract, term
from support.planar import PLANAR3, PLANAR4, arm_with_wheel, planar_contract

CONFIG = PlanarReach.config
CRITERION = PlanarReach.success_criterion(PLANAR3)


def task(robots=(0,), seed=1, spec=PLANAR3):
    return PlanarReach(spec, [robot_seed(seed, robot) for robot in robots])


def drawn(count, seed=0):
    each, rng = task(), np.random.default_rng(seed)
    return np.array([each.sample_goal(rng) for _ in range(count)])


GOALS = drawn(4000)


def test_goals_are_uniform_in_angle_and_radius():
    x, y, z = GOALS.T
    assert (y == 0).all()
    angle, radius = np.arctan2(z, x), np.hypot(x, z)
    for values, low, high in ((angle, -np.pi / 2, np.pi / 2), (radius, 0.3, 0.85)):
        assert low <= values.min() < low + 0.01
        assert high - 0.01 < values.max() <= high
        counts, _ = np.histogram(values, 10, (low, high))
        assert ((counts - 400) ** 2 / 400).sum() < 27.9  # chi-square of 9 degrees of freedom, 0.1 %


def test_every_goal_is_inside_the_whole_range():
    low, high = PLANAR3.joint_array("q_min"), PLANAR3.joint_array("q_max")
    assert PlanarChain.of_robot(PLANAR3).reaches(GOALS, low - 1e-9, high + 1e-9).all()


def test_one_goal_in_six_needs_more_than_nine_tenths_of_a_range():
    """17 %, all of them near the base."""
    core = CRITERION.core.contains(GOALS)
    assert core.mean() == pytest.approx(0.83, abs=0.02)
    radius = np.linalg.norm(GOALS, axis=1)
    assert radius[~core].max() < 0.5
    assert CRITERION.core.meaning == "inside 90 % of the joint ranges"


def test_a_joint_without_ends_leaves_more_core_goals(tmp_path):
    spec = load_robot(arm_with_wheel(tmp_path, "elbow"))
    core, more = (each.core.contains(GOALS) for each in (CRITERION, PlanarReach.success_criterion(spec)))
    assert (core <= more).all()
    assert more.mean() > core.mean() + 0.1


def test_core_goals_equal_those_of_brute_force():
    """Poses of a grid of 1.8 degrees inside 90 % of the ranges, by the kinematics of the nominal model."""
    axis = np.linspace(-0.9, 0.9, 91) * np.pi / 2
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(91, -1, 3)
    fleet = Fleet(PLANAR3, grid.shape[1])
    tools = np.concatenate([fleet.kinematics(q, jacobians=False).tool_position for q in grid])
    core, near = CRITERION.core.contains(GOALS), cKDTree(tools).query(GOALS)[0]
    coarse = np.pi / 100 / 2 * (0.9 + 0.6 + 0.3)
    assert near[core].max() < coarse
    assert (near[~core] > coarse / 5).mean() > 0.9  # the others are on the border


def test_goals_do_not_depend_on_grouping_or_on_the_wrist_rotation():
    together, alone, turned = task(range(3)), task((2,)), task(range(3), spec=PLANAR4)
    for _ in range(4):
        np.testing.assert_array_equal(together.goal[2], alone.goal[0])
        np.testing.assert_array_equal(together.goal, turned.goal)
        for each in (together, alone, turned):
            each.reset(np.ones(len(each.goal), dtype=bool))
    assert len(np.unique(together.goal, axis=0)) == 3


@pytest.mark.parametrize(("distance", "counts"), [(0.0299, 1), (0.0301, 0)])
def test_reached_is_the_centre_of_the_tool_inside_the_goal(distance, counts):
    each = task()
    for _ in range(round(CONFIG.period_s / PLANAR3.dt)):
        each.achieved[:] = each.goal + distance * np.array([0.6, 0.0, 0.8])
        each.step(np.ones(1, dtype=bool))
    assert (each.attempted.tolist(), each.reached.tolist()) == ([1], [counts])


def test_episodes_start_stretched():
    np.testing.assert_array_equal(task(range(5)).start_poses(np.random.default_rng(0)), np.zeros((5, 3)))


def test_the_observation_has_nine_numbers():
    assert sum(planar_contract().observation[k].size for k in range(3)) == 9
    assert [each.source for each in planar_contract().observation] == list(PlanarReach.observation)
    assert planar_contract(PLANAR4).observation_size == 10


def test_planar_robots_do_no_other_task_and_no_other_robot_does_this_one():
    assert tasks_of(PLANAR3) == tasks_of(PLANAR4) == ("planar_reach",)
    assert "planar_reach" not in tasks_of(SPEC)


def test_a_contract_of_this_task_for_another_robot_is_refused():
    terms = tuple(term(name, size) for name, size in (("joint_position", 6), ("goal_position", 3)))
    found = list(mismatches(arm_contract(task="planar_reach", observation=terms), SPEC))
    assert len(found) == 1
    assert found[0].startswith("task: found 'planar_reach', which needs a planar arm: ")
    with pytest.raises(RobotError, match="expected 3 parallel hinges"):
        task(spec=SPEC)


def test_a_planar_robot_has_no_workspace_to_reach_in():
    found = list(mismatches(planar_contract(task="reach"), PLANAR3))
    assert found == ["task: found 'reach', which needs [workspace]; planar3 has tool"]
