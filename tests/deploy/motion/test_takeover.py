"""Drives of a stop that become stiff, robot by robot and joint by joint."""

from types import SimpleNamespace

import numpy as np
import pytest

from deploy.motion.drive_modes import drive_modes
from deploy.motion.takeover import (
    DAMPING_RATE,
    DAMPING_SHARE,
    FALL_S,
    RANGE_SHARE,
    TAKEOVER_S,
    TAKEOVER_SHARE,
    Takeover,
)
from deploy.state import DriveMode, Setpoint
from robots.models.joint_inertia import joint_inertia
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from robots.motors.drive_gains import drive_gains
from robots.motors.gains import Gains
from support.arm6 import SPEC

N, ROBOTS = SPEC.n, 3
TICKS = round(TAKEOVER_S / SPEC.dt)
OWN = drive_gains(SPEC)
DAMPING = np.minimum(DAMPING_SHARE, DAMPING_RATE * joint_inertia(SPEC).most / OWN.kd)
"""Shares of their damping that drives begin with."""
FALL = np.exp(-SPEC.dt / FALL_S)
TORQUE = drive_modes(SPEC, ControlMode.TORQUE, None, ROBOTS)


def taking_over(drives=TORQUE):
    return Takeover(SPEC, drives.policy, drives.stop)


def drives_of(policy, drives=TORQUE):
    """Drives sent last: those of the policy for robots where `policy` (B,) holds, of a stop for others."""
    pick = np.array(policy)
    return DriveMode(
        mode=np.where(pick, drives.policy.mode, drives.stop.mode),
        kp=np.where(pick[:, None], drives.policy.kp, drives.stop.kp),
        kd=np.where(pick[:, None], drives.policy.kd, drives.stop.kd),
    )


def test_a_drive_without_a_policy_before_has_its_whole_stiffness():
    assert taking_over().drive is TORQUE.stop


def test_stiffness_and_damping_grow_by_the_same_factors_in_each_tick():
    takeover = taking_over()
    takeover.commit(TORQUE.policy)
    for tick in range(TICKS + 3):
        left = max(0.0, 1.0 - tick / TICKS)
        assert takeover.held.tolist() == [min(tick, TICKS)] * ROBOTS
        kp, kd = OWN.kp * TAKEOVER_SHARE**left, OWN.kd * DAMPING**left
        np.testing.assert_allclose(takeover.drive.kp, np.tile(kp, (ROBOTS, 1)), rtol=1e-12)
        np.testing.assert_allclose(takeover.drive.kd, np.tile(kd, (ROBOTS, 1)), rtol=1e-12)
        assert (takeover.drive.mode == ControlMode.POSITION).all()
        assert takeover.complete.tolist() == [tick >= TICKS] * ROBOTS
        takeover.commit(takeover.drive)


def test_a_stop_begins_soft_after_torques_and_stays_stiff_after_angles():
    takeover = taking_over()
    drive = takeover.drive_after(drives_of([True, False, True]))
    begins = np.array([1.0, 0.0, 1.0])[:, None]
    np.testing.assert_allclose(drive.kp, OWN.kp * TAKEOVER_SHARE**begins, rtol=1e-12)
    np.testing.assert_allclose(drive.kd, OWN.kd * DAMPING**begins, rtol=1e-12)


def test_a_stop_that_begins_on_drives_under_a_load_is_no_stiffer_at_once():
    """They were sent softer than their time allows."""
    takeover, rise = taking_over(), TAKEOVER_SHARE ** (-1.0 / TICKS)
    loaded = TORQUE.stop._replace(kp=0.3 * TORQUE.stop.kp)
    np.testing.assert_allclose(takeover.drive_after(loaded).kp, 0.3 * rise * TORQUE.stop.kp, rtol=1e-12)
    np.testing.assert_array_equal(takeover.drive_after(TORQUE.stop).kp, TORQUE.stop.kp)


def test_a_light_joint_begins_with_less_damping():
    """A push moves it by more than its estimate, and the damping of that has all of its motor's torque."""
    assert (DAMPING[3:] < 0.5 * DAMPING_SHARE).all()
    assert (DAMPING[:2] == DAMPING_SHARE).all()


def test_robots_take_over_on_their_own():
    takeover = taking_over()
    takeover.commit(drives_of([True, False, True]))
    assert takeover.held.tolist() == [0, TICKS, 0]
    np.testing.assert_allclose(takeover.drive.kp[:, 0] / OWN.kp[0], [TAKEOVER_SHARE, 1.0, TAKEOVER_SHARE])
    takeover.end(np.array([True, False, False]))
    assert takeover.held.tolist() == [TICKS, TICKS, 0]


def test_joints_that_held_their_angle_stay_stiff():
    wheel = Gains(np.where(np.arange(N) == 5, 0.0, OWN.kp), OWN.kd)
    drives = drive_modes(SPEC, ControlMode.VELOCITY, wheel, ROBOTS)
    takeover = taking_over(drives)
    takeover.commit(drives.policy)
    begins = np.where(np.arange(N) == 5, 1.0, 0.0)
    kp, kd = OWN.kp * TAKEOVER_SHARE**begins, OWN.kd * DAMPING**begins
    np.testing.assert_allclose(takeover.drive.kp, np.tile(kp, (ROBOTS, 1)), rtol=1e-12)
    np.testing.assert_allclose(takeover.drive.kd, np.tile(kd, (ROBOTS, 1)), rtol=1e-12)


MOST = RANGE_SHARE * torque_max(SPEC)
SIGNS = np.array([1, -1, 1, -1, 1, -1])


def drive_at(takeover, error, speed=0.0, tau=0.0):
    """Drive of a stop whose setpoint is `error` rad and `speed` rad/s from the estimate, with `tau` N·m fed forward."""
    still = np.zeros((ROBOTS, N))
    state = SimpleNamespace(q=still + 0.3, qd=still - 0.2)
    stop = Setpoint(q=state.q + error, qd=state.qd + speed, qdd=still)
    return takeover.drive_in_range(stop, state, still + tau)


def settled(takeover, *found):
    """Drive once kp has come to where the error, speed and torque of `found` let it be."""
    for _ in range(3 * TICKS):
        takeover.commit(drive_at(takeover, *found))
    return drive_at(takeover, *found)


@pytest.mark.parametrize("share", [-0.5, 0.0, 0.5])
@pytest.mark.parametrize("speed", [-0.02, 0.0, 0.02])
def test_a_drive_that_is_far_from_its_angle_stiffens_up_to_a_share_of_its_range(share, speed):
    takeover, tau = taking_over(), share * torque_max(SPEC)
    damped = OWN.kd * speed
    error = 2.0 * (torque_max(SPEC) + np.abs(tau + damped)) / OWN.kp * SIGNS
    drive = settled(takeover, error, speed, tau)
    assert (drive.kp < OWN.kp).all()
    np.testing.assert_allclose(tau + drive.kp[0] * error + damped, SIGNS * MOST, rtol=1e-9)
    np.testing.assert_array_equal(drive.kd, takeover.drive.kd)


def test_a_drive_that_is_near_its_angle_has_the_stiffness_of_its_time():
    takeover = taking_over()
    for error in (0.99 * MOST / OWN.kp * SIGNS, 0.0, np.nan):
        np.testing.assert_array_equal(drive_at(takeover, error).kp, TORQUE.stop.kp)
    takeover.commit(TORQUE.policy)
    for _ in range(TICKS):
        np.testing.assert_allclose(drive_at(takeover, 0.1 * MOST / OWN.kp).kp, takeover.drive.kp, rtol=1e-12)
        takeover.commit(drive_at(takeover, 0.0))


def test_one_estimate_neither_softens_nor_stiffens_a_drive_at_once():
    """Down to a share of what was sent; up again no faster than a drive that takes over."""
    takeover, far = taking_over(), 2.0 * MOST / (TAKEOVER_SHARE * OWN.kp)
    soft = drive_at(takeover, far)
    np.testing.assert_allclose(soft.kp, FALL * TORQUE.stop.kp, rtol=1e-12)
    takeover.commit(soft)
    np.testing.assert_allclose(drive_at(takeover, far).kp, FALL**2 * TORQUE.stop.kp, rtol=1e-12)
    rise = TAKEOVER_SHARE ** (-1.0 / TICKS)
    np.testing.assert_allclose(drive_at(takeover, 0.0).kp, FALL * rise * TORQUE.stop.kp, rtol=1e-12)
    takeover.end(np.array([True, False, False]))
    np.testing.assert_allclose(drive_at(takeover, 0.0).kp[:2, 0] / OWN.kp[0], [1.0, FALL * rise], rtol=1e-12)


@pytest.mark.parametrize("error", [0.02, 0.0])
def test_a_drive_whose_range_is_used_up_keeps_the_stiffness_that_it_begins_with(error):
    drive = settled(taking_over(), error, 0.0, 1.5 * torque_max(SPEC))
    soft = TAKEOVER_SHARE if error else 1.0
    np.testing.assert_allclose(drive.kp, soft * TORQUE.stop.kp)
