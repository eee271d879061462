"""Brake of joints of a floating base: none for joints that can stop, more the faster they are."""

import numpy as np
import pytest

from deploy.motion.joint_brake import ACCELERATION_SHARE, REACTION_TICKS, SPEED_SHARE, JointBrake
from robots.models.joint_inertia import joint_inertia
from robots.models.nominal_model import torque_max
from robots.spec import load_robot

WALKER = load_robot("quadruped")
LOW, HIGH, QDD = (WALKER.joint_array(field) for field in ("q_min", "q_max", "qdd_max"))
BRAKE = JointBrake(WALKER)


def stopping_speed(room):
    """rad/s from which a joint comes to rest after so much room, by integration of an even deceleration."""
    return np.sqrt(2.0 * ACCELERATION_SHARE * QDD * room)


@pytest.mark.parametrize("room", [0.02, 0.1, 0.3])
def test_joints_that_can_stop_are_left_alone(room):
    slow = 0.999 * np.minimum(stopping_speed(room), SPEED_SHARE * WALKER.joint_array("qd_max"))
    for q, qd in ((HIGH - room, slow), (LOW + room, -slow), (HIGH - room, -slow), (LOW + room, 0.0 * slow)):
        assert not BRAKE.torque(q[None], qd[None]).any()


@pytest.mark.parametrize("room", [0.0, 0.02, 0.1])
def test_joints_that_cannot_stop_are_braked_by_their_inertia_in_the_reaction_time(room):
    inertia = joint_inertia(WALKER)
    expected = np.sqrt(inertia.least * inertia.most) * 2.0 / (REACTION_TICKS * WALKER.dt)
    assert (expected < torque_max(WALKER)).all()
    fast = stopping_speed(room) + 2.0
    np.testing.assert_allclose(BRAKE.torque((HIGH - room)[None], fast[None])[0], -expected, rtol=1e-9)
    np.testing.assert_allclose(BRAKE.torque((LOW + room)[None], -fast[None])[0], expected, rtol=1e-9)


def test_joints_beyond_an_end_are_sent_back():
    still = np.zeros((1, WALKER.n))
    assert (BRAKE.torque(HIGH[None] + 0.01, still) < 0.0).all()
    assert (BRAKE.torque(LOW[None] - 0.01, still) > 0.0).all()


def test_no_joint_may_be_nearly_as_fast_as_its_limit():
    middle, limit = (LOW + HIGH)[None] / 2.0, WALKER.joint_array("qd_max")[None]
    for sign in (-1.0, 1.0):
        assert (sign * BRAKE.torque(middle, 0.9 * sign * limit) < 0.0).all()


def test_brake_has_the_torque_of_the_drives():
    for sign in (-1.0, 1.0):
        found = BRAKE.torque(HIGH[None] - 0.1, sign * np.full((1, WALKER.n), 1e6))
        np.testing.assert_array_equal(found, -sign * torque_max(WALKER)[None])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_joints_without_a_known_motion_are_not_braked(bad):
    q, qd = HIGH[None] - 0.1, np.zeros((1, WALKER.n))
    q[0, 1] = bad
    assert not np.isnan(BRAKE.torque(q, qd)).any()
    qd[0, 2] = np.nan
    assert not BRAKE.torque(q, qd)[0, 2:].any()
