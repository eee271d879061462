import numpy as np
import pytest

from deploy.estimation.resting_angles import DIFFERENCE_STD, MEAN_S, RestingAngles
from support.arm6 import SPEC

DT, N = SPEC.dt, SPEC.n
MOST, STD = round(MEAN_S / DT), 0.5e-3


def estimates(count, robots=2, seed=3):
    return np.random.default_rng(seed).normal(0.3, STD, size=(count, robots, N))


def step(resting, q, at_rest):
    resting.step(q, np.full(q.shape, STD**2), np.array(at_rest))


def test_mean_since_a_robot_rests():
    resting, q = RestingAngles(SPEC, 2), estimates(MOST)
    for k, each in enumerate(q):
        step(resting, each, [True, k >= 10])  # the second comes to rest later
    np.testing.assert_allclose(resting.q[0], q[:, 0].mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(resting.q[1], q[10:, 1].mean(axis=0), atol=1e-12)
    assert resting.ticks.tolist() == [MOST, MOST - 10]


def test_a_robot_that_does_not_rest_is_where_its_estimate_is():
    resting, q = RestingAngles(SPEC, 2), estimates(20)
    for each in q:
        step(resting, each, [True, True])
    step(resting, q[0], [True, False])
    np.testing.assert_array_equal(resting.q[1], q[0, 1])
    assert resting.ticks.tolist() == [21, 0]
    step(resting, q[1], [True, True])
    np.testing.assert_array_equal(resting.q[1], q[1, 1])  # the mean begins again


def test_numbers_that_are_not_finite_do_not_last():
    resting = RestingAngles(SPEC, 1)
    step(resting, np.full((1, N), np.nan), [False])
    step(resting, np.ones((1, N)), [True])
    np.testing.assert_array_equal(resting.q, 1.0)


@pytest.mark.parametrize(("rad_s", "behind_s"), [(1e-3, MEAN_S), (0.05, DIFFERENCE_STD * STD / 0.05)])
def test_joints_that_creep_are_followed(rad_s, behind_s):
    """Slow ones are followed half a second later, others at once if they are further than noise from the mean."""
    resting, q, behind = RestingAngles(SPEC, 1), np.zeros((1, N)), 0.0
    for _ in range(4 * MOST):
        step(resting, q, [True])
        behind = max(behind, (q - resting.q).max())
        q += rad_s * DT
    assert 0.5 * rad_s * behind_s < behind <= rad_s * behind_s
