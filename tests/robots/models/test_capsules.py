"""Capsules against coal."""

import coal
import numpy as np
import pytest

from robots.models.capsules import all_above, find_near

TOLERANCE_M = 1e-6


def turn_to(axis):
    """A rotation that turns z to an axis."""
    across = np.cross(axis, [0.6, -0.8, 0.1])
    across /= np.linalg.norm(across)
    return np.stack((across, np.cross(axis, across), axis), axis=1)


def coal_distance(centre, axis, half, radius):
    """m between two capsules, negative where they overlap."""
    shapes = [coal.Capsule(r, 2 * length) for r, length in zip(radius, half, strict=True)]
    places = [coal.Transform3s(turn_to(u), c) for u, c in zip(axis, centre, strict=True)]
    return coal.distance(
        shapes[0], places[0], shapes[1], places[1], coal.DistanceRequest(), coal.DistanceResult()
    )


def near(centre, axis, half, reach):
    found = np.empty(1, dtype=bool)
    find_near(centre, axis, np.array(half), np.array([[0, 1]]), np.array([reach]), found)
    return bool(found[0])


def unit(x):
    return x / np.linalg.norm(x)


DIRECTIONS = {
    "any": lambda rng: (unit(rng.normal(size=3)), unit(rng.normal(size=3))),
    "parallel": lambda _: (unit(np.ones(3)),) * 2,
    "opposite": lambda _: (unit(np.ones(3)), -unit(np.ones(3))),
    "nearly parallel": lambda rng: (unit(np.ones(3)), unit(np.ones(3) + 1e-6 * rng.normal(size=3))),
    "crossing at a right angle": lambda _: (np.array([1.0, 0, 0]), np.array([0, 1.0, 0])),
}


@pytest.mark.parametrize("half", [(0.2, 0.1), (0.2, 0.0), (0.0, 0.0)])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_capsules_are_near_from_the_distance_that_coal_finds(direction, half):
    radius, rng = (0.03, 0.05), np.random.default_rng(3)
    for _ in range(200):
        centre, axis = rng.uniform(-0.3, 0.3, (2, 3)), np.array(DIRECTIONS[direction](rng))
        reach = sum(radius) + coal_distance(centre, axis, half, radius)
        if reach > TOLERANCE_M:  # segments that cross have no distance that could be less
            assert not near(centre, axis, half, reach - TOLERANCE_M)
        assert near(centre, axis, half, reach + TOLERANCE_M)


@pytest.mark.parametrize("nowhere", [np.nan, np.inf])
def test_a_capsule_at_no_place_is_near(nowhere):
    centre, axis = np.array([[0.0, 0, 0], [9, 9, 9]]), np.array([[0.0, 0, 1], [1, 0, 0]])
    assert not near(centre, axis, (0.1, 0.1), 0.1)
    centre[1] = nowhere
    assert near(centre, axis, (0.1, 0.1), 0.1)


def test_each_robot_has_pairs_of_its_own():
    """Three robots of three balls: the second one's last two are near each other."""
    centre, axis = np.zeros((9, 3)), np.tile([0.0, 0.0, 1.0], (9, 1))
    centre[:, 0] = 0, 1, 2, 0, 1, 1.05, 0, 1, 2
    found = np.empty(3, dtype=bool)
    find_near(centre, axis, np.zeros(3), np.array([[0, 1], [1, 2]]), np.array([0.1, 0.1]), found)
    assert found.tolist() == [False, True, False]


@pytest.mark.parametrize(("height", "clear"), [(0.301, True), (0.299, False), (np.nan, False)])
def test_a_capsule_is_above_by_its_lower_end(height, clear):
    """0.2 m long, 60° from the vertical, above 0.25 m; another shape may be anywhere."""
    heights, steepness = np.array([-5.0, height]), np.array([1.0, -0.5])
    assert all_above(heights, steepness, np.array([0.3, 0.1]), np.array([-np.inf, 0.25])) is clear
