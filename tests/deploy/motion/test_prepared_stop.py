"""The stop that is ready to be sent, robot by robot: what one has is not another's."""

import numpy as np
import pytest

from deploy.motion.drive_modes import drive_modes
from deploy.motion.prepared_stop import PreparedStop, select
from deploy.state import Setpoint
from robots.motors.control_mode import ControlMode
from support.arm6 import SPEC

N, ROBOTS = SPEC.n, 3
FREE, STIFF = (drive_modes(SPEC, mode, None, ROBOTS) for mode in (ControlMode.TORQUE, ControlMode.POSITION))
SOME = np.array([True, False, True])


def setpoint(seed, drive=None, *, tau=True):
    q, qd, qdd, torque = np.random.default_rng(seed).normal(size=(4, ROBOTS, N))
    return Setpoint(q, qd, qdd, torque if tau else None, drive)


def assert_rows(found, rows, expected, drive):
    for ours, theirs in zip(found[:4], expected[:4], strict=True):
        np.testing.assert_array_equal(ours[rows], theirs[rows])
    for ours, theirs in zip(found.drive, drive, strict=True):
        np.testing.assert_array_equal(ours[rows], theirs[rows])


@pytest.mark.parametrize("drives", [FREE, STIFF], ids=["free", "stiff"])
def test_it_begins_at_rest_with_the_drives_of_a_stop(drives):
    stop = PreparedStop(drives)
    assert not np.array([*stop.setpoint[:3], stop.tau]).any()
    assert stop.setpoint.q.shape == (ROBOTS, N)
    assert stop.setpoint.drive is drives.stop
    assert np.isnan(stop.setpoint.tau).all() if drives.free else stop.setpoint.tau is None


def test_robots_without_a_stop_have_none_that_is_finite():
    stop, ahead = PreparedStop(FREE), setpoint(1, FREE.stop)
    stop.prepare(SOME, ahead, ahead.tau)
    assert_rows(stop.setpoint, SOME, ahead, FREE.stop)
    assert np.isnan(np.array(stop.setpoint[:3])[:, ~SOME]).all()
    assert stop.tau is ahead.tau


def test_robots_that_rest_get_the_drives_of_a_stop_and_others_keep_theirs():
    stop, ahead, here = PreparedStop(FREE), setpoint(1, FREE.policy), setpoint(2)
    stop.prepare(np.ones(ROBOTS, dtype=bool), ahead, ahead.tau)
    stop.rest(SOME, here)
    assert_rows(stop.setpoint, SOME, here._replace(tau=np.full((ROBOTS, N), np.nan)), FREE.stop)
    assert_rows(stop.setpoint, ~SOME, ahead, FREE.policy)


@pytest.mark.parametrize("drives", [FREE, STIFF], ids=["free", "stiff"])
def test_a_saved_stop_is_put_back(drives):
    stop, ahead = PreparedStop(drives), setpoint(1, drives.policy, tau=False)
    stop.prepare(np.ones(ROBOTS, dtype=bool), ahead, ahead.q + 1.0)
    saved, other = stop.save(), PreparedStop(drives)
    other.restore(saved)
    for ours, theirs in zip((*other.setpoint[:3], other.tau), (*ahead[:3], ahead.q + 1.0), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    for ours, theirs in zip(other.setpoint.drive, drives.policy, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert other.setpoint.drive.mode.dtype == drives.policy.mode.dtype
    assert np.isnan(other.setpoint.tau).all() if drives.free else other.setpoint.tau is None
    saved["q"][:] = 9.0
    assert not (other.setpoint.q == 9.0).any()


def test_each_robot_gets_its_own_of_two_setpoints():
    here, elsewhere = setpoint(1, FREE.policy), setpoint(2, FREE.stop)
    found = select(SOME, here, elsewhere)
    assert_rows(found, SOME, here, FREE.policy)
    assert_rows(found, ~SOME, elsewhere, FREE.stop)
    assert select(np.ones(ROBOTS, dtype=bool), here, elsewhere) is here


@pytest.mark.parametrize("missing", ["here", "elsewhere"])
def test_torques_and_drives_that_one_of_both_lacks_are_those_of_the_first(missing):
    whole, bare = setpoint(1, FREE.policy), setpoint(2, tau=False)
    here, elsewhere = (bare, whole) if missing == "here" else (whole, bare)
    found = select(SOME, here, elsewhere)
    assert found.tau is here.tau
    assert found.drive is here.drive
