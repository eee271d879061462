"""Torques that change no faster than allowed, and no faster in their rate."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deploy.motion.torque_ramp import TorqueRamp
from robots.margins import ModeMargins
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from support.arm6 import SPEC

N, DT = SPEC.n, SPEC.dt
RATE, RATE2 = (
    np.array([getattr(j.torque_mode, f"{name}_max") for j in SPEC.joints]) for name in ("rate", "rate2")
)
LIMIT = SPEC.margins.of(ControlMode.TORQUE).tau * torque_max(SPEC)


def ride(targets, robots=1):
    """Torques sent (T, B, n)."""
    ramp, sent = TorqueRamp(SPEC, robots), []
    for target in targets:
        ramp.commit(*ramp.next(target), followed=np.ones(robots, dtype=bool))
        sent.append(ramp.tau.copy())
    return np.array(sent)


def assert_inside_limits(sent):
    rate = np.diff(np.concatenate((np.zeros((2, *sent.shape[1:])), sent)), axis=0) / DT
    assert (np.abs(rate) <= RATE * (1 + 1e-9)).all()
    assert (np.abs(np.diff(rate, axis=0)) / DT <= RATE2 * (1 + 1e-6)).all()


def test_range_of_torques_is_that_of_torque_mode():
    margins = SPEC.margins.model_copy(update={"torque_mode": ModeMargins(tau=0.25)})
    ramp = TorqueRamp(SPEC.model_copy(update={"margins": margins}), 1)
    np.testing.assert_allclose(ramp.clamped(np.full((1, N), 1e9))[0], 0.25 * torque_max(SPEC))


def test_a_step_is_reached_and_not_passed():
    goal = 0.5 * LIMIT * np.array([1, -1, 1, -1, 1, -1])
    sent = ride([goal[None]] * 200)
    assert_inside_limits(sent)
    np.testing.assert_allclose(sent[-1, 0], goal, rtol=1e-9)
    assert (np.abs(sent) <= np.abs(goal) * (1 + 1e-9)).all()
    straight = np.abs(goal) / RATE / DT
    reached = (np.abs(sent[:, 0] - goal) < 1e-3 * LIMIT).argmax(axis=0)
    assert (reached <= straight + 2 * RATE / (RATE2 * DT) + 3).all()  # but for the ticks that the rate needs


def without_limit_of_rate():
    joints = [
        joint.model_copy(update={"torque_mode": joint.torque_mode.model_copy(update={"rate_max": 1e9})})
        for joint in SPEC.joints
    ]
    return SPEC.model_copy(update={"joints": tuple(joints)})


@pytest.mark.parametrize("periods", [1, 2, 3, 8, 20])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.999, 1.0])
def test_the_rate_is_the_highest_that_ends_at_the_target(periods, share):
    """Closed form: rates r, r − S dt, … of which the last is a share of S dt cover the distance exactly."""
    step = RATE2 * DT
    rates = step * (share + np.arange(periods)[::-1, None])
    ramp, target = TorqueRamp(without_limit_of_rate(), 1), 0.4 * LIMIT
    ramp.tau[:], ramp.rate[:] = target - rates.sum(axis=0) * DT, rates[0]
    for expected in rates:
        tau, rate = ramp.next(target[None])
        np.testing.assert_allclose(rate[0], expected, rtol=1e-9)
        ramp.commit(tau, rate, followed=np.array([True]))
    np.testing.assert_allclose(ramp.tau[0], target, rtol=1e-9)


def test_a_robot_that_did_not_follow_begins_at_rest():
    ramp, tau = TorqueRamp(SPEC, 2), np.full((2, N), 3.0)
    ramp.commit(tau, np.ones((2, N)), followed=np.array([True, False]))
    assert (ramp.tau == 3.0).all()
    assert (ramp.rate == [[1.0], [0.0]]).all()


def test_a_target_beyond_the_range_ends_at_its_margin():
    np.testing.assert_allclose(ride([np.full((1, N), 1e308)] * 400)[-1, 0], LIMIT, rtol=1e-9)


def test_the_margin_is_that_of_torque_mode():
    own = SPEC.margins.torque_mode.model_copy(update={"tau": 0.5})
    spec = SPEC.model_copy(update={"margins": SPEC.margins.model_copy(update={"torque_mode": own})})
    most = TorqueRamp(spec, 1).clamped(np.full((1, N), 1e308))[0]
    np.testing.assert_allclose(most, 0.5 * torque_max(SPEC))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_no_targets_leave_the_limits(seed):
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.uniform(-3, 4, (40, 2, N))
    targets = np.repeat(rng.choice([-1.0, 1.0], sizes.shape) * sizes, rng.integers(1, 9), axis=0)
    assert_inside_limits(ride(targets, robots=2))
