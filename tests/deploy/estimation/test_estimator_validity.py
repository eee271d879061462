"""When an estimate is not to be believed, and that it says so."""

import numpy as np
import pytest

from deploy.estimation.estimator import Estimator
from deploy.estimation.fault_detection import STUCK_S
from deploy.estimation.joint_filter import CONFIRMED_S, GATE, NIS_MAX, REFUSED_S
from deploy.reasons import Reason
from support.arm6 import SPEC
from support.deploy.estimators import DT, NOISE, N, begun, packets, sample, still

CONFIRMED, REFUSED = round(CONFIRMED_S / DT), round(REFUSED_S / DT)


def test_estimate_is_invalid_before_confirmation():
    """And a first packet that is wrong is nobody's: the second, which contradicts it, takes its place."""
    estimator, ages, errors = Estimator(SPEC, 2), [], []
    for tick in range(30):
        z = np.zeros((2, N))
        z[1, 3] = 0.4 if tick == 0 else 0.0
        state = estimator.step(tick * DT, sample([tick * DT] * 2, [True] * 2, z), still(2))
        ages.append(state.age.copy())
        errors.append(np.abs(state.q[1]).max())
    ages = np.array(ages)
    assert np.isinf(ages[: CONFIRMED - 1]).all()
    assert np.isinf(ages[CONFIRMED - 1]).tolist() == [False, True]
    assert (ages[CONFIRMED:] == 0.0).all()
    assert errors[0] == pytest.approx(0.4)
    assert max(errors[1:]) < 1e-9


def test_wrong_packet_after_an_outage_is_still_gated():
    estimator, rng = Estimator(SPEC, 1), np.random.default_rng(14)
    for tick in range(160):
        z = rng.normal(0, NOISE, (1, N))
        z[0, 1] += 0.5 if tick == 120 else 0.0
        heard = not 100 <= tick < 120
        state = estimator.step(tick * DT, sample([tick * DT], [heard], z), still(1))
        if tick >= 120:
            assert np.abs(state.q).max() < 0.01
            assert np.abs(state.qd).max() < 0.5


def test_motion_without_a_setpoint_is_estimated():
    estimator, rng = Estimator(SPEC, 2), np.random.default_rng(15)
    for tick in range(60):
        z = rng.normal(0, NOISE, (2, N))
        z[1] += 0.3 * tick * DT
        estimator.step(tick * DT, sample([tick * DT] * 2, [True] * 2, z), still(2))
    assert estimator.moving.any(axis=1).tolist() == [False, True]


def test_joint_that_does_not_follow_is_estimated_at_its_true_position():
    """Power has gone, say: the setpoint moves on, the joint stays."""
    estimator = Estimator(SPEC, 1)
    for tick in range(100):
        speed = min(tick * DT, 0.5)
        setpoint = still(1, speed**2 / 2)._replace(qd=np.full((1, N), speed))
        state = estimator.step(tick * DT, sample([tick * DT], [True], np.zeros((1, N))), setpoint)
    np.testing.assert_allclose(state.q, 0.0, atol=2e-3)
    np.testing.assert_allclose(state.qd, 0.0, atol=0.05)


def test_one_dead_channel_leaves_the_other_joints_their_packets():
    """And its own age tells of it."""
    estimator, clean = begun(2), begun(2)
    for tick, s, setpoint in packets(np.random.default_rng(4), 2, 100, 0.0):
        bad = sample(*(np.copy(part) for part in s["encoder"]))
        if tick >= 50:
            bad["encoder"].value[1, 2] = np.nan
        state, expected = estimator.step(tick * DT, bad, setpoint), clean.step(tick * DT, s, setpoint)
    others = np.arange(N) != 2
    np.testing.assert_array_equal(state.q[:, others], expected.q[:, others])
    np.testing.assert_array_equal(state.q[0], expected.q[0])
    assert state.age[1] >= 49 * DT
    assert state.age[0] == expected.age[0]
    assert state.q_var[1, 2] > 10 * expected.q_var[1, 2]


def test_gross_errors_are_gated_out():
    estimator, clean, rng = Estimator(SPEC, 1), Estimator(SPEC, 1), np.random.default_rng(9)
    for tick in range(120):
        z = rng.normal(0, NOISE, (1, N))
        bad, lost = z.copy(), z.copy()
        if 100 <= tick < 103:
            bad[0, 3], lost[0, 3] = 0.5, np.nan
        state = estimator.step(tick * DT, sample([tick * DT], [True], bad), still(1))
        expected = clean.step(tick * DT, sample([tick * DT], [True], lost), still(1))
        np.testing.assert_array_equal(state.q, expected.q)
        assert state.age[0] == expected.age[0]
    assert 1.0 < estimator.joints.nis[0, 3] < NIS_MAX


def test_true_jump_is_tracked_again_and_reported():
    """A filter that refused all samples for ever would be blind, one that took them at once would believe anything."""
    estimator, faults, errors = Estimator(SPEC, 1), [], []
    for tick in range(400):
        z = np.full((1, N), 0.0 if tick < 100 else 0.4)
        state = estimator.step(tick * DT, sample([tick * DT], [True], z), still(1))
        faults.append(bool(state.fault[0] & Reason.DIVERGED))
        errors.append(np.abs(state.q - z).max())
    refused = 100 + REFUSED
    assert min(errors[100 : refused - 1]) > 0.39
    assert max(errors[refused:]) < 1e-3
    assert all(faults[refused - 5 : refused + 20])
    assert not any(faults[:100] + faults[300:])


@pytest.mark.parametrize("standard_deviations", [0.5 * GATE, 2.0 * GATE])
def test_gate_threshold_is_exact(standard_deviations):
    estimator, rng = Estimator(SPEC, 1), np.random.default_rng(10)
    for tick in range(100):
        estimator.step(tick * DT, sample([tick * DT], [True], rng.normal(0, NOISE, (1, N))), still(1))
    away = still(1).q + standard_deviations * np.sqrt(estimator.joints.p00 + NOISE**2)
    state = estimator.step(100 * DT, sample([100 * DT], [True], away), still(1))
    assert state.age[0] == pytest.approx(0.0 if standard_deviations < GATE else DT)


def test_stuck_encoder_is_distinguished_from_rest():
    """Only where the joint was sent elsewhere meanwhile, and slowly enough for the filter to follow the lie."""
    estimator, faults = Estimator(SPEC, 2), []
    for tick in range(400):
        speed = np.array([[0.0], [0.1]])
        setpoint = still(2, speed * tick * DT)._replace(qd=still(2, speed).q)
        q = still(2, speed * min(tick, 200) * DT).q
        faults.append(
            estimator.step(tick * DT, sample([tick * DT] * 2, [True] * 2, q), setpoint).fault.copy()
        )
    found = np.array(faults) & Reason.STUCK != 0
    assert not found[:, 0].any()
    first = 200 + round(STUCK_S / DT)
    assert not found[:first, 1].any()
    assert found[first + 5 :, 1].all()


def test_repeated_large_innovations_are_a_divergence():
    """A joint that shakes at a rate and size which the model calls impossible, within the gate."""
    estimator, faults = Estimator(SPEC, 2), []
    for tick in range(300):
        q = np.zeros((2, N))
        q[1, 5] = 5.0 * NOISE * (-1.0) ** tick if tick >= 100 else 0.0
        faults.append(
            estimator.step(tick * DT, sample([tick * DT] * 2, [True] * 2, q), still(2)).fault.copy()
        )
    found = np.array(faults) & Reason.DIVERGED != 0
    assert not found[:, 0].any()
    assert not found[:110, 1].any()
    assert found[200:, 1].all()
