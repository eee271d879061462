"""Distances between shapes, against Pinocchio's and against the simulation."""

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("mujoco")

from deploy.backends.sim.plant import Plant
from eval.margins.gaps import FAR_M, Gaps
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.models.nominal_model import load_pinocchio
from robots.randomness import robot_seed
from support.arm6 import SPEC

ROBOTS = 2


@pytest.fixture(scope="module")
def plant():
    """Arms in the middle of their draws, at home."""
    distributions = load_distributions(SPEC)
    robots = median_draw(distributions, SPEC, ROBOTS)
    return Plant(SPEC, distributions, robots, [robot_seed(1, robot) for robot in range(ROBOTS)])


@pytest.fixture(scope="module")
def gaps(plant):
    return Gaps(SPEC, plant)


def test_distances_are_those_of_pinocchio(gaps):
    model, geometry = load_pinocchio(SPEC)
    for pair in gaps.pairs:
        names = (gaps._model.geom(geom).name for geom in pair)
        geometry.addCollisionPair(pin.CollisionPair(*(geometry.getGeometryId(name) for name in names)))
    low, high = SPEC.joint_array("q_min"), SPEC.joint_array("q_max")
    poses = np.random.default_rng(3).uniform(low, high, (40, SPEC.n))
    data, placements, near = model.createData(), geometry.createData(), 0
    for pose, planned in zip(poses, gaps.planned(poses), strict=True):
        pin.updateGeometryPlacements(model, data, geometry, placements, pose)
        pin.computeDistances(geometry, placements)
        expected = np.array([found.min_distance for found in placements.distanceResults])
        apart = expected > 0.0
        np.testing.assert_allclose(planned[apart], np.minimum(expected, FAR_M)[apart], atol=1e-4)
        assert (planned[~apart] < 1e-4).all()
        near += (expected < FAR_M).sum()
    assert near > 100


def test_shapes_of_one_link_and_of_neighbours_are_left_out(gaps):
    names = {frozenset(gaps._model.geom(geom).name for geom in pair) for pair in gaps.pairs}
    assert frozenset(("forearm", "base")) in names
    assert frozenset(("table", "wrist_3")) in names
    assert frozenset(("upper_arm", "forearm")) not in names
    assert frozenset(("table", "base")) not in names


def test_simulated_robots_at_their_setpoint_are_as_planned(gaps, plant):
    home = np.tile(SPEC.joint_array("q_home"), (ROBOTS, 1))
    plant.reset(np.ones(ROBOTS, dtype=bool), home)
    np.testing.assert_allclose(gaps.true(), gaps.planned(home), atol=1e-3)
    moved = home.copy()
    moved[1, 1] += 0.3
    plant.reset(np.ones(ROBOTS, dtype=bool), moved)
    np.testing.assert_allclose(gaps.true(), gaps.planned(moved), atol=1e-3)
    assert np.abs(gaps.true()[1] - gaps.true()[0]).max() > 0.01
