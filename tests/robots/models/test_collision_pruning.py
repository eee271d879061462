import itertools

import numpy as np
import pinocchio as pin
import pytest

from robots.errors import RobotError
from robots.models.collision_pruning import prune_pairs
from robots.models.collisions import collision_pairs
from robots.models.fleet import Fleet
from robots.models.nominal_model import load_pinocchio
from robots.spec import load_robot
from support.arm6 import SPEC, copy_of_arm
from support.robots.model_files import POST

N = SPEC.n
LOW, HIGH = SPEC.joint_array("q_min"), SPEC.joint_array("q_max")


def names_of(shapes, pairs):
    return {tuple(shapes.geometryObjects[i].name for i in pair) for pair in pairs}


def test_pairs_that_no_time_is_left_for_are_kept(monkeypatch):
    arm, shapes = load_pinocchio(SPEC)
    pairs = collision_pairs(arm, shapes)
    assert len(prune_pairs(SPEC, arm, shapes, pairs)) < len(pairs)
    monkeypatch.setattr("robots.models.collision_pruning.PLACES_MAX", 0)
    assert prune_pairs(SPEC, arm, shapes, pairs) == pairs


@pytest.mark.parametrize(
    ("bound", "most", "found"), [("SHAPES_MAX", 7, "8 shapes"), ("PAIRS_MAX", 3, r"\d+ pairs of shapes")]
)
def test_more_shapes_than_a_tick_can_check_are_refused(monkeypatch, bound, most, found):
    monkeypatch.setattr(f"robots.models.collisions.{bound}", most)
    said = rf"robot\.toml: capsules: found {found}, expected at most {most}: declare fewer"
    with pytest.raises(RobotError, match=said):
        Fleet(SPEC, 1, collisions=True)


@pytest.mark.slow
def test_unchecked_pairs_cannot_collide():
    """Proven for every pose of the working ranges; looked at here in its corners and in 5,000 poses."""
    arm, shapes = load_pinocchio(SPEC)
    pairs = collision_pairs(arm, shapes)
    idle = [pair for pair in pairs if pair not in prune_pairs(SPEC, arm, shapes, pairs)]
    assert names_of(shapes, idle) == {
        *{("table", "upper_arm"), ("shoulder", "forearm"), ("shoulder", "wrist_1"), ("upper_arm", "wrist_1")},
        *{("forearm", "wrist_2"), ("wrist_1", "wrist_3")},
    }
    alone = shapes.copy()
    for pair in idle:
        alone.addCollisionPair(pin.CollisionPair(*pair))
    arm_data, places, rng = arm.createData(), alone.createData(), np.random.default_rng(0)
    corners = np.array(list(itertools.product(*zip(LOW, HIGH, strict=True))))
    for q in np.concatenate((corners, rng.uniform(LOW, HIGH, (5000, N)))):
        pin.computeDistances(arm, arm_data, alone, places, q)
        assert min(found.min_distance for found in places.distanceResults) > SPEC.margins.collision_m


def test_pairs_nearer_than_the_margin_are_checked():
    """wrist_1 and wrist_3 pass each other at 26 mm."""
    arm, shapes = load_pinocchio(SPEC)
    pairs = collision_pairs(arm, shapes)
    for margin, kept in ((0.015, False), (0.028, True)):
        spec = SPEC.model_copy(update={"margins": SPEC.margins.model_copy(update={"collision_m": margin})})
        found = names_of(shapes, prune_pairs(spec, arm, shapes, pairs))
        assert (("wrist_1", "wrist_3") in found) == kept


def test_post_on_the_base_is_checked_at_any_place_in_the_file(tmp_path):
    """It is welded to the world as the base is, and comes last: its pairs name the moving link first."""
    xml = [(r"</body>\s*</body>\s*</worldbody>", rf"</body>{POST}</body></body></worldbody>")]
    away = [("q_home = 0.0", "q_home = 1.2")]
    spec = load_robot(copy_of_arm(tmp_path, xml=xml, toml=away))
    arm, shapes = load_pinocchio(spec)
    pairs = collision_pairs(arm, shapes)
    kept = names_of(shapes, prune_pairs(spec, arm, shapes, pairs))
    assert {("forearm", "post"), ("wrist_3", "post")} <= kept
    fleet, rng, hits = Fleet(spec, 16, collisions=True), np.random.default_rng(0), 0
    data, alone = arm.createData(), shapes.copy()
    for pair in pairs:
        alone.addCollisionPair(pin.CollisionPair(*pair))
    places = alone.createData()
    for q in rng.uniform(LOW, HIGH, (40, 16, N)):
        kinematics = fleet.kinematics(q)
        for i in range(16):
            pin.computeDistances(arm, data, alone, places, q[i])
            nearest = min(found.min_distance for found in places.distanceResults) - spec.margins.collision_m
            assert kinematics.colliding[i] == (nearest < 0) or abs(nearest) < 1e-4
            hits += nearest < 0
    assert hits > 30


def test_home_pose_in_collision_is_refused(tmp_path):
    xml = [(r"</body>\s*</body>\s*</worldbody>", rf"</body>{POST}</body></body></worldbody>")]
    spec = load_robot(copy_of_arm(tmp_path, xml=xml))
    with pytest.raises(
        RobotError, match=r"q_home: there 'wrist_3' and 'post' are -29\.5 mm apart, expected .*, 13 mm"
    ):
        Fleet(spec, 1, collisions=True)
    Fleet(spec, 1)


def test_shapes_on_different_branches_of_a_robot_prune_pairs():
    """Neither carries the other: both move."""
    arm, shapes = load_pinocchio(SPEC)
    joint = arm.addJoint(1, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([0.3, -0.13, 0.2])), "other")
    ball = pin.GeometryObject(
        "ball", joint, pin.SE3(np.eye(3), np.array([0.2, 0, 0])), shapes.geometryObjects[1].geometry
    )
    number, forearm = shapes.addGeometryObject(ball), shapes.getGeometryId("forearm")
    joints = (*SPEC.joints, SPEC.joints[0].model_copy(update={"name": "other"}))
    spec = SPEC.model_copy(update={"joints": joints})
    for pair in ((forearm, number), (number, forearm)):
        assert prune_pairs(spec, arm, shapes, [pair]) == [pair]
