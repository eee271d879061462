"""Points to walk to: where they lie, where the robot reckons it is, and what the judge measures."""

from types import SimpleNamespace

import numpy as np
import pytest

from deploy.policy.compatibility import check_contract
from deploy.tasks.task import tasks_of
from deploy.tasks.waypoint import NEAR_M, PACE, TOLERANCE_M, Waypoint, farthest, turned
from deploy.truth import BaseTruth
from robots.errors import ContractError
from robots.models.nominal_model import imu_in_base, load_pinocchio
from robots.randomness import robot_seed
from robots.rotations import exp, from_up, matrix, matvec, product
from robots.spec import load_robot
from support.arm6 import SPEC
from support.paths import TEST_ROBOTS
from support.quadruped import QUADRUPED, quadruped_contract

simulate = pytest.importorskip("deploy.simulation").simulate

DT, FAR = QUADRUPED.dt, PACE * QUADRUPED.base.command_max[0] * QUADRUPED.base.command_s
PERIOD = round(QUADRUPED.base.command_s / DT)
IMU = imu_in_base(QUADRUPED, load_pinocchio(QUADRUPED)[0])
OBSERVATION = ("waypoint_direction", "waypoint_distance", "joint_position")


def task(robots=(0,), seed=1, spec=QUADRUPED):
    return Waypoint(spec, [robot_seed(seed, robot) for robot in robots])


class Arc:
    """A base that leans, walks forwards and turns: its truth, and the estimate of an IMU that makes no errors.

    The estimate's world is turned against the true one: no sensor measures yaw.
    """

    def __init__(self, robots, speed=0.8, turning=0.3, start=(5.0, -3.0), heading=2.0, yaw_offset=1.1):
        self.robots, self.speed, self.turning = robots, speed, turning
        self.start, self.heading, self.yaw_offset = np.array(start), heading, yaw_offset
        self.lean = from_up(np.array([[0.1, -0.15, 1.0]]) / np.linalg.norm([0.1, -0.15, 1.0]))

    def angle(self, t):
        return self.heading + self.turning * t

    def place(self, t):
        """Closed form of a circle, (2,)."""
        radius, begin, now = self.speed / self.turning, self.heading, self.angle(t)
        return self.start + radius * np.array([np.sin(now) - np.sin(begin), np.cos(begin) - np.cos(now)])

    def _quat(self, angle):
        return np.repeat(product(exp(np.array([[0.0, 0.0, angle]])), self.lean), self.robots, axis=0)

    def _motion(self, t):
        """Velocity in the world and angular velocity in the base."""
        quat, now = self._quat(self.angle(t)), self.angle(t)
        velocity = np.tile([self.speed * np.cos(now), self.speed * np.sin(now), 0.0], (self.robots, 1))
        turn = np.tile([0.0, 0.0, self.turning], (self.robots, 1))
        return quat, velocity, matvec(matrix(quat).swapaxes(1, 2), turn)

    def truth(self, t):
        quat, velocity, turn = self._motion(t)
        position = np.tile([*self.place(t), 0.3], (self.robots, 1))
        return SimpleNamespace(base=BaseTruth(position, quat, velocity, turn, np.zeros_like(position)))

    def runtime(self, t, each):
        quat, velocity, turn = self._motion(t)
        at_imu = matvec(matrix(quat).swapaxes(1, 2), velocity) + np.cross(turn, IMU)
        base = SimpleNamespace(
            quat_wxyz=self._quat(self.angle(t) + self.yaw_offset),
            velocity_in_base=at_imu,
            angular_velocity=turn,
        )
        return SimpleNamespace(base=base, task=each, spec=QUADRUPED)


def walk(each, arc, ticks, begin=0):
    """Ticks as the runtime's and the judge's; what the judge saw last."""
    achieved = None
    for tick in range(begin, begin + ticks):
        each.observe(arc.runtime(tick * DT, each), None, True)
        each.step(np.ones(arc.robots, dtype=bool))
        achieved = each.true_achieved(arc.truth((tick + 1) * DT))
    return achieved


def test_points_lie_between_nearest_and_farthest_in_every_direction():
    each, found = task(range(400)), []
    for _ in range(5):
        found.append(each.goal.copy())
        each.reset(np.ones(400, dtype=bool))
    found = np.concatenate(found)
    distance, direction = np.hypot(*found.T), np.arctan2(found[:, 1], found[:, 0])
    assert farthest(QUADRUPED) == FAR
    assert NEAR_M <= distance.min() < distance.max() <= FAR
    for values, low, high in ((distance, NEAR_M, FAR), (direction, -np.pi, np.pi)):
        counts = np.histogram(values, 8, (low, high))[0]
        assert ((counts - 250) ** 2 / 250).sum() < 24.3  # χ² with 7 degrees of freedom, 1 of 1000


def test_reckoned_and_true_way_agree_with_the_circle():
    each, arc = task(range(2)), Arc(2)
    truth = walk(each, arc, 1000)
    way = turned((arc.place(1000 * DT) - arc.place(0.0))[None], np.array([-arc.heading]))[0]
    # One tick of the way: both begin with the first look after a point was given, the truth at its end.
    np.testing.assert_allclose(each.achieved, np.tile(way, (2, 1)), atol=0.006)
    np.testing.assert_allclose(truth, np.tile(way, (2, 1)), atol=0.006)
    assert np.hypot(*way) > 3.0


def test_direction_and_distance_are_those_of_the_point_in_the_robots_frame():
    each, arc = task(range(3)), Arc(3)
    walk(each, arc, 1000)
    now = 999 * DT
    place = arc.place(0.0) + turned(each.goal, np.full(3, arc.heading))
    expected = turned(place - arc.place(now), np.full(3, -arc.angle(now)))
    direction, distance = (
        Waypoint.sources[f"waypoint_{name}"].read(arc.runtime(now, each))
        for name in ("direction", "distance")
    )
    np.testing.assert_allclose(distance[:, 0], np.hypot(*expected.T), atol=0.01)
    angle = np.arctan2(expected[:, 1], expected[:, 0])
    np.testing.assert_allclose(direction, np.stack((np.sin(angle), np.cos(angle)), axis=1), atol=0.01)


def test_a_point_is_judged_when_its_time_ends_and_the_next_one_begins_at_zero():
    each, arc = task(range(2)), Arc(2)
    each.goal[0] = turned((arc.place(PERIOD * DT) - arc.place(0.0))[None], np.array([-arc.heading]))[0]
    first = each.goal.copy()
    truth = walk(each, arc, PERIOD)
    assert each.ended.all()
    np.testing.assert_array_equal(each.ended_goal, first)
    assert (
        each.criterion.distance(truth, first)[0]
        <= 0.01
        < TOLERANCE_M
        < each.criterion.distance(truth, first)[1]
    )
    assert each.reached.tolist() == [1, 0]
    again = each.true_achieved(arc.truth(PERIOD * DT))
    np.testing.assert_array_equal(again, truth)  # whoever looks a second time sees the same
    each.observe(arc.runtime(PERIOD * DT, each), None, True)
    np.testing.assert_allclose(each.achieved, truth, atol=0.02)  # of the point that is over
    np.testing.assert_array_equal(each.moved, 0.0)  # the policy reads the new one
    each.step(np.ones(2, dtype=bool))
    np.testing.assert_array_equal(each.true_achieved(arc.truth((PERIOD + 1) * DT)), 0.0)
    truth = walk(each, arc, 200, begin=PERIOD + 1)
    way = turned(
        (arc.place((PERIOD + 201) * DT) - arc.place(PERIOD * DT))[None], -np.array([arc.angle(PERIOD * DT)])
    )
    np.testing.assert_allclose(truth, np.tile(way, (2, 1)), atol=0.006)
    np.testing.assert_allclose(each.achieved, truth, atol=0.012)


def test_an_episode_that_ends_with_its_point_begins_at_once():
    """Training rests a robot in the tick in which its point ended."""
    each, arc = task(range(2)), Arc(2)
    walk(each, arc, PERIOD)
    each.reset(np.array([True, False]))
    elsewhere = Arc(2, start=(90.0, 90.0))
    found = each.true_achieved(elsewhere.truth(0.0))
    np.testing.assert_array_equal(found[0], 0.0)
    assert np.hypot(*found[1]) > 50.0


def test_arming_begins_anew():
    each, arc = task(range(2)), Arc(2)
    walk(each, arc, 300)
    goal = each.goal.copy()
    each.arm(np.array([False, True]))
    assert (each.goal[1] != goal[1]).any()
    truth = walk(each, arc, 1, begin=300)
    assert np.hypot(*truth[0]) > 1.0
    np.testing.assert_array_equal(truth[1], 0.0)
    np.testing.assert_array_equal(each.achieved[1], 0.0)


def test_saved_and_restored_goes_on_alike():
    arc, one, other = Arc(2), task(range(2)), task(range(2))
    walk(one, arc, 300)
    other.restore(one.save())
    np.testing.assert_array_equal(walk(one, arc, 100, begin=300), walk(other, arc, 100, begin=300))
    np.testing.assert_array_equal(one.achieved, other.achieved)


def test_shorter_periods_have_nearer_points():
    shorter = Waypoint.limit_goal_period(QUADRUPED, 4.0)
    assert farthest(shorter) == pytest.approx(0.4 * FAR)
    assert np.hypot(*task(range(50), spec=shorter).goal.T).max() <= 0.4 * FAR
    at_once = Waypoint.limit_goal_period(QUADRUPED, 0.2)
    np.testing.assert_allclose(np.hypot(*task(range(5), spec=at_once).goal.T), NEAR_M)


def test_only_robots_that_walk_have_it():
    assert tasks_of(QUADRUPED) == ("velocity", "waypoint")
    assert "waypoint" not in tasks_of(SPEC)
    still = load_robot(TEST_ROBOTS / "quadruped")
    contract = quadruped_contract(still, "waypoint", OBSERVATION[:1])
    with pytest.raises(
        ContractError, match=r"task: found 'waypoint', which needs 1 m forwards in each period"
    ):
        check_contract(contract, still, "walk.onnx")


def test_a_standing_robot_reads_its_point_as_it_was_given():
    """In the whole runtime; what it reads moves with the errors of its velocity alone."""
    seeds = [robot_seed(3, robot) for robot in range(2)]
    contract = quadruped_contract(task="waypoint", observation=OBSERVATION)
    runtime, robot = simulate(QUADRUPED, contract, seeds)
    each, zero, last = runtime.task, np.zeros((2, 12)), None
    for tick in range(round(1.5 / DT)):
        if tick == round(0.5 / DT):
            assert not runtime.arm(np.ones(2, dtype=bool)).any()
        observation = runtime.sense()
        runtime.act(None if observation is None else zero)
        truth = each.true_achieved(robot.truth())
        last = observation.copy() if observation is not None else last
    angle = np.arctan2(each.goal[:, 1], each.goal[:, 0])
    np.testing.assert_allclose(last[:, :2], np.stack((np.sin(angle), np.cos(angle)), axis=1), atol=0.1)
    np.testing.assert_allclose(last[:, 2] * FAR, np.hypot(*each.goal.T), atol=0.05)
    np.testing.assert_allclose(each.achieved, truth, atol=0.05)
