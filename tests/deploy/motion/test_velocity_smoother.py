"""Velocity mode: speeds are reached, kept below their limit, and end before the joint's range does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deploy.motion.smoother import VelocitySmoother
from robots.motors.control_mode import ControlMode
from support.arm6 import SPEC

N, DT = SPEC.n, SPEC.dt
HOME = SPEC.joint_array("q_home")
V, A, J = (SPEC.joint_array(f"{name}_max") for name in ("qd", "qdd", "qddd"))
LOW = SPEC.joint_array("q_min") + SPEC.margins.q_target_rad
HIGH = SPEC.joint_array("q_max") - SPEC.margins.q_target_rad


def at_home(robots):
    smoother = VelocitySmoother(SPEC, robots)
    smoother.hold(np.ones(robots, dtype=bool), np.tile(HOME, (robots, 1)))
    return smoother


def ride(smoother, speeds, stops=None):
    """Angles and speeds sent (T, B, n), from rest on."""
    robots, sent = len(smoother.q), []
    for tick, speed in enumerate(speeds):
        stopping = np.zeros(robots, dtype=bool) if stops is None else stops[tick]
        smoother.commit(smoother.next(np.broadcast_to(speed, (robots, N)), stopping))
        sent.append((smoother.q.copy(), smoother.qd.copy()))
    return np.array(sent).transpose(1, 0, 2, 3)


def assert_inside_limits(q):
    derivative = np.concatenate((np.repeat(np.tile(HOME, (1, q.shape[1], 1)), 3, axis=0), q))
    for limit in (SPEC.margins.of(ControlMode.VELOCITY).speed * V, A, J):
        derivative = np.diff(derivative, axis=0) / DT
        assert (np.abs(derivative) <= limit * (1 + 1e-5)).all()
    assert (q >= LOW - 1e-9).all()
    assert (q <= HIGH + 1e-9).all()


def test_a_joint_moves_at_the_speed_that_is_asked_for_and_back():
    smoother = at_home(1)
    q, qd = ride(smoother, [0.15 * V] * 60 + [-0.1 * V] * 100)
    assert_inside_limits(q)
    joints = HIGH > HOME + 0.4  # those with room for it
    np.testing.assert_allclose(qd[55, 0, joints], (0.15 * V)[joints], rtol=1e-9)
    np.testing.assert_allclose(qd[-1, 0], -0.1 * V, rtol=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_speed_above_the_limit_ends_at_rest_at_the_end_of_the_range(sign):
    """Ruckig's velocity interface alone would reach that speed, and run through the end."""
    q, qd = ride(at_home(1), [sign * 9.0 * V] * 1000)
    assert_inside_limits(q)
    np.testing.assert_allclose(q[-1, 0], HIGH if sign > 0 else LOW, atol=1e-9)
    np.testing.assert_allclose(qd[-1, 0], 0.0, atol=1e-9)
    room = HIGH - HOME if sign > 0 else HOME - LOW
    fastest = np.minimum(SPEC.margins.of(ControlMode.VELOCITY).speed * V, np.sqrt(A * room))
    assert np.abs(qd[:, 0]).max(axis=0) == pytest.approx(fastest, rel=0.35)


def test_almost_no_speed_is_none():
    smoother = at_home(1)
    ride(smoother, [0.5 * V] * 30)
    q, qd = ride(smoother, [1e-4 * V] * 200)
    np.testing.assert_allclose(qd[-1], 0.0, atol=1e-12)
    np.testing.assert_allclose(q[-1], q[-50], rtol=0, atol=1e-12)


def test_a_slow_joint_moves_at_a_small_share_of_its_speed():
    """It would come to the end of its range in hours."""
    slow = tuple(joint.model_copy(update={"qd_max": 0.05}) for joint in SPEC.joints)
    smoother = VelocitySmoother(SPEC.model_copy(update={"joints": slow}), 1)
    smoother.hold(np.ones(1, dtype=bool), HOME[None])
    _, qd = ride(smoother, [np.full(N, 1e-4)] * 50)
    np.testing.assert_allclose(qd[-1, 0], 1e-4, rtol=1e-9)


@given(st.integers(0, 2**32 - 1), st.sampled_from(["random", "ends", "small"]))
@settings(max_examples=20)
def test_no_sequence_of_speeds_leaves_the_limits(seed, kind):
    rng = np.random.default_rng(seed)
    shape = (60, 3, N)
    speeds = {
        "random": lambda: rng.uniform(-2, 2, shape) * V,
        "ends": lambda: rng.choice([-9.0, 9.0], shape) * V,
        "small": lambda: rng.normal(0, 2e-3, shape) * V,
    }[kind]()
    stops = np.repeat(rng.random((60, 3)) < 0.1, 4, axis=0)
    q, _ = ride(at_home(3), np.repeat(speeds, 4, axis=0), stops)
    assert np.isfinite(q).all()
    assert_inside_limits(q)


def test_a_robot_does_not_depend_on_its_neighbours():
    rng = np.random.default_rng(3)
    speeds = np.repeat(rng.uniform(-1, 1, (50, 3, N)) * V, 4, axis=0)
    together, _ = ride(at_home(3), speeds)
    alone, _ = ride(at_home(1), speeds[:, 1:2])
    np.testing.assert_array_equal(together[:, 1:2], alone)


def test_saved_and_restored_goes_on_bit_for_bit():
    rng, one, other = np.random.default_rng(4), at_home(2), at_home(2)
    speeds = np.repeat(rng.uniform(-1, 1, (30, 2, N)) * V, 4, axis=0)
    ride(one, speeds[:61])
    other.restore(one.save())
    np.testing.assert_array_equal(ride(one, speeds[61:]), ride(other, speeds[61:]))
