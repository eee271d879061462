import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from deploy.policy.action import Action
from deploy.policy.contract_action import ActionSpec
from support.arm6 import position_drives

SCALE = (0.05, 0.05, 0.05, 0.1, 0.1, 0.2)
LEASH = 0.3
SPEC = ActionSpec(mode="position_increment", size=6, scale=SCALE, clip=(-1.0, 1.0), leash_rad=LEASH)
EVERY = np.array([True, True])


def started(q=0.0):
    action = Action(SPEC, position_drives(2))
    action.reset(EVERY, np.full((2, 6), q))
    return action


def test_moves_the_target_by_scaled_and_clipped_actions():
    action = started(0.5)
    target = action.step(np.array([[1.0, -1, 0.5, 0, 7, -7]] * 2), np.full((2, 6), 0.5))
    np.testing.assert_allclose(target.value, [[0.55, 0.45, 0.525, 0.5, 0.6, 0.3]] * 2, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(action.last, [[1, -1, 0.5, 0, 1, -1]] * 2)
    assert target.finite.all()


@settings(max_examples=60)
@given(
    actions=arrays(float, (20, 2, 6), elements=st.floats(width=32)),
    setpoints=arrays(float, (20, 2, 6), elements=st.floats(-3, 3)),
)
def test_target_is_bounded_by_leash_and_step(actions, setpoints):
    action = started()
    for raw, setpoint in zip(actions, setpoints, strict=True):
        before = action.value.copy()
        target = action.step(raw, setpoint)
        assert np.isfinite(target.value).all()
        assert (np.abs(action.last) <= 1).all()
        finite = np.isfinite(raw).all(axis=1)
        np.testing.assert_array_equal(target.finite, finite)
        assert (np.abs(target.value - setpoint)[finite] <= LEASH + 1e-12).all()
        np.testing.assert_array_equal(target.value[~finite], before[~finite])
        step = before + np.array(SCALE) * action.last
        np.testing.assert_array_equal(
            target.value[finite], np.clip(step, setpoint - LEASH, setpoint + LEASH)[finite]
        )


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_action_changes_nothing_and_is_reported(bad):
    action = started(0.2)
    action.step(np.full((2, 6), 0.5), np.full((2, 6), 0.2))
    before = action.save()
    raw = np.full((2, 6), 0.5)
    raw[1, 3] = bad
    target = action.step(raw, np.full((2, 6), 0.2))
    assert target.finite.tolist() == [True, False]
    np.testing.assert_array_equal(target.value[1], before["value"][1])
    np.testing.assert_array_equal(action.last[1], before["last"][1])
    assert (target.value[0] != before["value"][0]).all()
    assert action.step(np.zeros((2, 6)), np.full((2, 6), 0.2)).finite.all()


def test_position_mode_does_not_depend_on_the_last_target():
    offset = (0.1, -0.2, 0.3, 0.0, 1.0, -1.0)
    spec = ActionSpec(mode="position", size=6, offset=offset, scale=SCALE, clip=(-2.0, 2.0))
    action = Action(spec, position_drives(2))
    action.reset(EVERY, np.full((2, 6), 5.0))
    raw, far = np.array([[1.0, -1, 0.5, 0, 7, -7], [0.0] * 6]), np.full((2, 6), 9.0)
    for _ in range(3):
        target = action.step(raw, far)
        expected = [[0.15, -0.25, 0.325, 0.0, 1.2, -1.4], offset]
        np.testing.assert_allclose(target.value, expected, rtol=0, atol=1e-15)
    action.step(np.full((2, 6), np.nan), far)
    np.testing.assert_allclose(action.value, expected, rtol=0, atol=1e-15)
    action.hold(EVERY, far)
    np.testing.assert_array_equal(action.value, far)


def test_single_precision_action_is_scaled_in_double_precision():
    raw = np.full((2, 6), 0.1, dtype=np.float32)
    target = started().step(raw, np.zeros((2, 6)))
    np.testing.assert_array_equal(target.value, [np.array(SCALE) * float(np.float32(0.1))] * 2)


def test_request_may_lie_beyond_joint_ranges():
    """What the policy wants is kept as it is: who clips it must still be able to count it."""
    action, setpoint = started(6.0), np.full((2, 6), 6.0)
    assert (action.step(np.ones((2, 6)), setpoint).value > 6.0).all()


def test_reset_of_a_subset():
    action = started()
    action.step(np.array([[0.5] * 6, [np.nan] * 6]), np.zeros((2, 6)))
    before = action.save()
    action.reset(np.array([False, True]), np.full((2, 6), 1.0))
    np.testing.assert_array_equal(action.value, [before["value"][0], np.ones(6)])
    np.testing.assert_array_equal(action.last[0], before["last"][0])
    np.testing.assert_array_equal(action.last[1], 0.0)
    assert action.finite.all()


def test_saved_and_restored_goes_on_bit_for_bit():
    rng, one, other = np.random.default_rng(0), started(), Action(SPEC, position_drives(2))
    for k in range(30):
        raw, setpoint = rng.normal(size=(2, 6)), rng.normal(size=(2, 6))
        one.step(raw, setpoint)
        if k == 10:
            other.restore(one.save())
        elif k > 10:
            np.testing.assert_array_equal(other.step(raw, setpoint).value, one.value)
