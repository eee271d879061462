"""Height of a floating base above its lowest foot."""

import numpy as np
import pytest

from deploy.reasons import Reason
from robots.rotations import matrix
from support.deploy.floating_bases import DT, F, settled
from support.walking import live, walker

sensor_faults = pytest.importorskip("deploy.backends.sim.sensor_faults")
Failure, Fault = sensor_faults.Failure, sensor_faults.Fault

PLACES = np.array([[0.0, 0.0, -0.30], [0.0, 0.0, -0.26], [0.0, 0.0, -0.28], [0.0, 0.0, 0.1]])
"""m, of feet below and above the IMU of two robots."""


def test_height_is_that_above_the_lowest_foot_by_the_estimated_tilt():
    base, stream = settled()
    t, imu, feet = stream[0]
    state = base.step(t, imu, feet._replace(position=np.tile(PLACES, (2, 1, 1))))
    leans = matrix(base.quat_wxyz)[:, 2, 2]
    assert imu.fresh.all()
    assert (leans < 0.9999).all()
    np.testing.assert_allclose(state.height, 0.30 * leans, atol=1e-12)


def test_height_stays_without_new_samples_and_is_unknown_after_a_reset():
    base, stream = settled()
    t, imu, feet = stream[0]
    before = base.step(t, imu, feet).height.copy()
    nothing = imu._replace(fresh=np.zeros(2, dtype=bool))
    np.testing.assert_array_equal(base.step(t + DT, nothing, feet).height, before)
    base.reset(np.array([True, False]))
    np.testing.assert_array_equal(base.height, [np.inf, before[1]])


@pytest.mark.parametrize(("lost", "expected"), [([0], 0.28), ([0, 2], 0.26), (range(F), 0.0)])
def test_feet_at_no_known_place_do_not_make_a_robot_high(lost, expected):
    base, stream = settled()
    t, imu, feet = stream[0]
    position = np.tile(PLACES, (2, 1, 1))
    position[0, list(lost)] = np.nan
    state = base.step(t, imu, feet._replace(position=position))
    leans = matrix(base.quat_wxyz)[:, 2, 2]
    np.testing.assert_allclose(state.height, [expected * leans[0], 0.30 * leans[1]], atol=1e-12)


def test_an_unknown_height_is_no_fall():
    """Samples that are missing are: an operator must not look for a robot on the floor."""
    silent = Fault(robot=0, sensor="gyro", channel=None, what=Failure.OFF, begins=1, ends=10**6)
    runtime = walker(1, faults=[silent])
    live(runtime, 2)
    runtime.reset(np.ones(1, dtype=bool))
    live(runtime, 40)
    assert np.isinf(runtime.base.height).all()
    found = Reason(int(runtime.arm(np.ones(1, dtype=bool))[0]))
    assert Reason.LOST in found
    assert Reason.FALLEN not in found
