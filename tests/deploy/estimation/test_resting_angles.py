import numpy as np
import pytest

from deploy.estimation.resting_angles import DIFFERENCE_STD, MEAN_S, RestingAngles
from eval.judge.limits import load_limits
from support.arm6 import SPEC

DT, N = SPEC.dt, SPEC.n
MOST, STD = round(MEAN_S / DT), 0.5e-3
DIFFERENCE = DIFFERENCE_STD * np.sqrt(SPEC.sensors["encoder"].variance)


def estimates(count, robots=2, seed=3):
    return np.random.default_rng(seed).normal(0.3, STD, size=(count, robots, N))


def step(resting, q, at_rest):
    resting.step(q, np.array(at_rest))


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
    assert resting.creeping(resting.q).all()
    step(resting, np.ones((1, N)), [True])
    np.testing.assert_array_equal(resting.q, 1.0)


@pytest.mark.parametrize("rad_s", [2e-3, 5e-3, 0.02, 0.05])
def test_joints_creep_if_the_mean_is_further_behind_than_noise(rad_s):
    """It is a time constant behind. What counts as rest is less than a robot may jump when it is armed."""
    resting, q = RestingAngles(SPEC, 1), np.zeros((1, N))
    for _ in range(8 * MOST):
        q += rad_s * DT
        step(resting, q, [True])
    behind = q[0, 0] - resting.q[0, 0]
    assert behind == pytest.approx(rad_s * MEAN_S, rel=0.1)
    assert resting.creeping(q).all() == (behind > DIFFERENCE)
    assert load_limits(SPEC).arming_rad > DIFFERENCE


def test_noise_is_not_creeping():
    resting = RestingAngles(SPEC, 2)
    for each in estimates(2 * MOST):
        step(resting, each, [True, True])
        assert not resting.creeping(each).any()


def test_an_older_estimate_counts_less():
    """After a time constant at another angle, within noise, a share of 1/e of the former one is left."""
    resting = RestingAngles(SPEC, 1)
    for angle in (0.0, 1e-3):
        for _ in range(MOST):
            step(resting, np.full((1, N), angle), [True])
    np.testing.assert_allclose(resting.q, 1e-3 * (1.0 - np.exp(-1.0)), rtol=0.02)
