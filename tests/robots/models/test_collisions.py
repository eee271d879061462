"""What is spared because it is above a table, against Pinocchio asked about every pair."""

from collections import Counter

import numpy as np
import pinocchio as pin
import pytest

from robots.models.blocks import BLOCK
from robots.models.collisions import PairChecks, collision_pairs
from robots.models.fleet import Fleet
from robots.models.nominal_model import load_pinocchio
from robots.spec import load_robot
from support.arm6 import SPEC, copy_of_arm

N, POSES = SPEC.n, 2000
LOW, HIGH = SPEC.joint_array("q_min"), SPEC.joint_array("q_max")
MARGIN = SPEC.margins.collision_m
TABLE = r'name="table" type="box" pos="0 0 -0.05" size="1.2 1.2 0.05"'
CURB = '<geom name="curb" type="box" pos="-0.5 0 0.1" size="0.05 1 0.05"/>'
WRIST_3 = r'name="wrist_3" type="capsule" fromto="0 0 -0.02 0 0 0" size="0.040"'


def instead(geom):
    """Another table."""
    return [(TABLE, f'name="table" {geom}')]


def after_the_arm(geom):
    return (r"</body>\s*</worldbody>", f"</body>{geom}</worldbody>")


# What stands around, by which name, and whether some poses are spared: nobody is who is below the highest point of it.
AROUND = {
    "the table": ([], "table", True),
    "tilted": (
        instead('type="box" pos="0 0 -0.12" euler="0.05 -0.04 0.3" size="0.9 0.9 0.02"'),
        "table",
        True,
    ),
    "block": (
        instead('type="box" pos="-0.5 -0.1 0" euler="0.5 0.3 0.2" size="0.15 0.3 0.05"'),
        "table",
        True,
    ),
    "cylinder": (instead('type="cylinder" pos="-0.5 0 0" euler="1.2 0 0.2" size="0.05 0.3"'), "table", True),
    "curb after the arm": ([after_the_arm(CURB)], "curb", True),
    "curb before the table": ([(f"<geom {TABLE}", f"{CURB}<geom {TABLE}")], "curb", True),
    "plane": (instead('type="plane" pos="0 0 0" size="0 0 1"'), "table", False),
    "tilted plane": (instead('type="plane" pos="0 0 -0.05" euler="0.1 0.1 0" size="0 0 1"'), "table", False),
    "wall": (instead('type="plane" pos="-0.7 0 0" euler="0 1.5708 0" size="0 0 1"'), "table", False),
    "a hand that is no capsule": (
        [(WRIST_3, 'name="wrist_3" type="box" size="0.04 0.06 0.05"')],
        "table",
        True,
    ),
}


def distances(spec, q, name=""):
    """(K,) m, the least between shapes that may not touch, in poses (K, n); of pairs with a shape of that name."""
    arm, shapes = load_pinocchio(spec)
    for a, b in collision_pairs(arm, shapes):
        if not name or name in (shapes.geometryObjects[a].name, shapes.geometryObjects[b].name):
            shapes.addCollisionPair(pin.CollisionPair(a, b))
    data, places = arm.createData(), shapes.createData()
    found = []
    for pose in q:
        pin.computeDistances(arm, data, shapes, places, pose)
        found.append(min(result.min_distance for result in places.distanceResults))
    return np.array(found)


def poses(count):
    """Random ones, half of them with the shoulder low."""
    rng = np.random.default_rng(0)
    q = rng.uniform(LOW, HIGH, (count, N))
    q[::2, 1] = rng.uniform(-0.6, HIGH[1], count // 2)
    q[1::4, 1] = rng.uniform(LOW[1], -1.9, count // 4)
    return q


def counted(monkeypatch):
    """The number of times that coal is asked, by the checks that ask it."""
    asked, look = Counter(), PairChecks.check

    def looked(checks, *at):
        asked[checks] += 1
        return look(checks, *at)

    monkeypatch.setattr(PairChecks, "check", looked)
    return asked


@pytest.mark.parametrize("around", AROUND)
def test_no_close_pair_is_skipped(tmp_path, monkeypatch, around):
    edits, obstacle, some_spared = AROUND[around]
    spec, asked = load_robot(copy_of_arm(tmp_path, xml=edits)), counted(monkeypatch)
    fleet, q, found = Fleet(spec, 1, collisions=True), poses(POSES), []
    for pose in q:
        kinematics = fleet.kinematics(pose[None])
        found.append(kinematics.colliding[0])
    distance = distances(spec, q)
    clear = np.abs(distance - MARGIN) > 1e-4
    np.testing.assert_array_equal(np.array(found)[clear], (distance < MARGIN)[clear])
    hits = (distances(spec, q, obstacle) < MARGIN - 1e-4).sum()
    assert 20 < hits < 0.9 * POSES
    spared = POSES - min(asked.values())  # pairs without obstacle are always looked at
    assert spared > 0.02 * POSES if some_spared else spared == 0


def test_one_low_robot_is_found_at_any_index(monkeypatch):
    """Alone among robots that nobody need ask about."""
    robots, home = 2 * BLOCK + 3, SPEC.joint_array("q_home")
    low = home.copy()
    low[1] = -0.3
    assert distances(SPEC, [low], "table")[0] < MARGIN < 0.1 < distances(SPEC, [home], "table")[0]
    fleet, asked = Fleet(SPEC, robots, collisions=True), counted(monkeypatch)
    kinematics = fleet.kinematics(np.tile(home, (robots, 1)))
    assert not asked
    for robot in range(robots):
        q = np.tile(home, (robots, 1))
        q[robot] = low
        kinematics = fleet.kinematics(q)
        np.testing.assert_array_equal(np.flatnonzero(kinematics.colliding), [robot])


def test_a_robot_without_shapes_collides_with_nothing(tmp_path):
    spec = load_robot(copy_of_arm(tmp_path))
    text = spec.model_path.read_text()
    lines = [line for line in text.splitlines() if "<geom name" not in line and "<exclude" not in line]
    spec.model_path.write_text("\n".join(lines))
    fleet = Fleet(spec, 3, collisions=True)
    kinematics = fleet.kinematics(np.zeros((3, N)))
    assert not kinematics.colliding.any()


def test_fleets_sharing_a_block_share_no_results():
    rng = np.random.default_rng(2)
    fleet, apart = Fleet(SPEC, 2 * BLOCK, collisions=True), Fleet(SPEC, 2 * BLOCK, collisions=True)
    other = fleet.resized(BLOCK)
    for _ in range(20):
        q, qd = rng.uniform(LOW, HIGH, (2 * BLOCK, N)), rng.normal(size=(2 * BLOCK, N))
        tau = fleet.torque(q, qd, qd)
        kinematics = fleet.kinematics(q)
        apart_kinematics = apart.kinematics(q)
        other_kinematics = other.kinematics(q[BLOCK:], jacobians=False)
        np.testing.assert_array_equal(other_kinematics.tool_position, apart_kinematics.tool_position[BLOCK:])
        np.testing.assert_array_equal(other_kinematics.colliding, apart_kinematics.colliding[BLOCK:])
        other.torque(q[:BLOCK], qd[:BLOCK], qd[:BLOCK])
        other_kinematics = other.kinematics(q[:BLOCK])
        np.testing.assert_array_equal(kinematics.tool_position, apart_kinematics.tool_position)
        np.testing.assert_array_equal(kinematics.tool_velocity(qd), apart_kinematics.tool_velocity(qd))
        np.testing.assert_array_equal(kinematics.manipulability(), apart_kinematics.manipulability())
        np.testing.assert_array_equal(kinematics.colliding, apart_kinematics.colliding)
        np.testing.assert_array_equal(tau, apart.torque(q, qd, qd))
