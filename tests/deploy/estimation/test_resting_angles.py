import numpy as np

from deploy.estimation.resting_angles import MEAN_S, RestingAngles
from support.arm6 import SPEC

DT, N = SPEC.dt, SPEC.n
MOST = round(MEAN_S / DT)


def estimates(count, robots=2, seed=3):
    return np.random.default_rng(seed).normal(size=(count, robots, N))


def test_mean_since_a_robot_rests():
    resting, q = RestingAngles(SPEC, 2), estimates(MOST)
    for k, each in enumerate(q):
        resting.step(each, np.array([True, k >= 10]))  # the second comes to rest later
    np.testing.assert_allclose(resting.q[0], q[:, 0].mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(resting.q[1], q[10:, 1].mean(axis=0), atol=1e-12)
    assert resting.ticks.tolist() == [MOST, MOST - 10]


def test_a_robot_that_does_not_rest_is_where_its_estimate_is():
    resting, q = RestingAngles(SPEC, 2), estimates(20)
    for each in q:
        resting.step(each, np.ones(2, dtype=bool))
    resting.step(q[0], np.array([True, False]))
    np.testing.assert_array_equal(resting.q[1], q[0, 1])
    assert resting.ticks.tolist() == [21, 0]
    resting.step(q[1], np.ones(2, dtype=bool))
    np.testing.assert_array_equal(resting.q[1], q[1, 1])  # the mean begins again


def test_numbers_that_are_not_finite_do_not_last():
    resting = RestingAngles(SPEC, 1)
    resting.step(np.full((1, N), np.nan), np.zeros(1, dtype=bool))
    resting.step(np.ones((1, N)), np.ones(1, dtype=bool))
    np.testing.assert_array_equal(resting.q, 1.0)


def test_joints_that_creep_are_followed():
    """After twice the time, the mean is at most that time times their speed behind."""
    resting, rad = RestingAngles(SPEC, 1), 0.01 * DT
    for k in range(1, 4 * MOST):
        resting.step(np.full((1, N), k * rad), np.ones(1, dtype=bool))
    assert 0.0 < k * rad - resting.q.min() < 0.01 * MEAN_S
