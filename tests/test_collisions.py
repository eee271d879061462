"""What is spared because it is above a table, against Pinocchio asked about every pair."""

import numpy as np
import pinocchio as pin
import pytest
from test_spec import SPEC, copy_of_arm

from robots import collisions
from robots.collisions import collision_pairs
from robots.model_pinocchio import Fleet, load_pinocchio
from robots.spec import load_robot

N, POSES = SPEC.n, 2000
LOW, HIGH = SPEC.joint_array("q_min"), SPEC.joint_array("q_max")
TABLE = r'(<geom name="table" type="box") pos="0 0 -0.05" size="1.2 1.2 0.05"'
CURB = '<geom name="curb" type="box" pos="0.6 0 0.1" size="0.05 1 0.05"/>'
SURROUNDINGS = {
    "the table": [],
    "a tilted table": [(TABLE, r'\1 pos="0 0 -0.12" euler="0.05 -0.04 0.3" size="0.9 0.9 0.02"')],
    "a tilted block": [(TABLE, r'\1 pos="0.5 -0.1 0.1" euler="0.5 0.3 0.2" size="0.15 0.3 0.05"')],
    "a curb listed after the arm": [(r"</body>\s*</worldbody>", f"</body>{CURB}</worldbody>")],
}


def nearest(spec, q):
    """(K,) m, between shapes that may not touch, of poses (K, n)."""
    arm, shapes = load_pinocchio(spec)
    for pair in collision_pairs(arm, shapes):
        shapes.addCollisionPair(pin.CollisionPair(*pair))
    data, places = arm.createData(), shapes.createData()
    distances = []
    for pose in q:
        pin.computeDistances(arm, data, shapes, places, pose)
        distances.append(min(found.min_distance for found in places.distanceResults))
    return np.array(distances)


@pytest.mark.parametrize("around", SURROUNDINGS)
def test_nothing_that_is_too_near_is_spared(tmp_path, monkeypatch, around):
    """Half of the poses have the shoulder low; some robots are spared the question, and some are not."""
    spec = load_robot(copy_of_arm(tmp_path, xml=SURROUNDINGS[around]))
    margin, rng, asked, look = spec.margins.collision_m, np.random.default_rng(0), [], collisions._Shapes.look
    fleet, q = Fleet(spec, 1, collisions=True), rng.uniform(LOW, HIGH, (POSES, N))
    q[::2, 1] = rng.uniform(-0.6, 0.0, POSES // 2)

    def counted(shapes, *at):
        asked.append(shapes)
        return look(shapes, *at)

    monkeypatch.setattr(collisions._Shapes, "look", counted)
    found = []
    for pose in q:
        fleet.place(pose[None])
        found.append(fleet.colliding[0])
    distance = nearest(spec, q)
    clear = np.abs(distance - margin) > 1e-4
    np.testing.assert_array_equal(np.array(found)[clear], (distance < margin)[clear])
    assert 30 < sum(found) < 0.9 * POSES
    assert 0.1 * POSES < 2 * POSES - len(asked) < 0.9 * POSES
