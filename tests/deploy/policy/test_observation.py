import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from deploy.policy.contract import Contract
from deploy.policy.contract_term import Term
from deploy.policy.observation import Observation
from support.contracts import arm_contract

SIZES = {"joint_position": 6, "goal_from_tool": 3}


def term(source, history=1, clip=None, scale=None, name=None, **fields):
    frame, unit = {"joint_position": ("joint", "rad"), "goal_from_tool": ("world", "m")}[source]
    size = SIZES[source]
    return Term(
        name=name or source,
        source=source,
        frame=frame,
        unit=unit,
        size=size,
        scale=scale or (1.0,) * size,
        clip=clip,
        history=history,
        **fields,
    )


class Readings:
    """Sources that a test sets by hand."""

    def __init__(self, robots):
        self.now = {name: np.zeros((robots, size)) for name, size in SIZES.items()}

    def sources(self):
        return {name: lambda name=name: self.now[name] for name in self.now}


def built(*terms, robots=2):
    whole = arm_contract()
    contract = Contract.model_construct(**{**dict(whole), "observation": terms})
    readings = Readings(robots)
    return Observation(contract, readings.sources(), robots), readings


def test_terms_in_order_divided_by_their_scale():
    scale = (1.0, 2.0, 4.0, 0.5, 1.0, 10.0)
    observation, readings = built(term("goal_from_tool"), term("joint_position", scale=scale))
    readings.now["joint_position"][:] = [[1, 2, 3, 4, 5, 6], [0, 0, 0, 0, 0, -1]]
    readings.now["goal_from_tool"][:] = [[0.1, 0.2, 0.3], [7, 8, 9]]
    frames = observation.step()
    assert frames.dtype == np.float32
    expected = [[0.1, 0.2, 0.3, 1, 1, 0.75, 8, 5, 0.6], [7, 8, 9, 0, 0, 0, 0, 0, -0.1]]
    np.testing.assert_array_equal(frames, np.array(expected, dtype=np.float32))


def test_offset_is_subtracted_before_scaling():
    observation, readings = built(term("goal_from_tool", scale=(0.5, 1.0, 2.0), offset=(0.25, 0.0, -1.0)))
    readings.now["goal_from_tool"][:] = [[1, 2, 3], [0.25, -1, 0]]
    expected = np.array([[1.5, 2, 2], [0, -1, 0.5]], dtype=np.float32)
    np.testing.assert_array_equal(observation.step(), expected)
    assert readings.now["goal_from_tool"].tolist() == [[1, 2, 3], [0.25, -1, 0]]


def test_history_may_begin_with_zeros():
    observation, readings = built(
        term("goal_from_tool", history=3, fill="zeros"), term("joint_position", history=2), robots=2
    )
    seen = []
    for k in range(1, 5):
        if k == 3:
            observation.reset(np.array([False, True]))
        readings.now["goal_from_tool"][:] = readings.now["joint_position"][:] = np.full((2, 1), k)
        seen.append(observation.step()[:, [0, 3, 6, 9, 15]].tolist())
    assert [both[0] for both in seen] == [[0, 0, 1, 1, 1], [0, 1, 2, 1, 2], [1, 2, 3, 2, 3], [2, 3, 4, 3, 4]]
    assert [both[1] for both in seen] == [[0, 0, 1, 1, 1], [0, 1, 2, 1, 2], [0, 0, 3, 3, 3], [0, 3, 4, 3, 4]]


def test_clip_comes_after_scaling():
    observation, readings = built(term("goal_from_tool", scale=(0.1, 1.0, 10.0), clip=(-2.0, 3.0)))
    readings.now["goal_from_tool"][:] = [[1, 1, 1], [-1, -5, -5]]
    np.testing.assert_array_equal(
        observation.step(), np.array([[3, 1, 0.1], [-2, -2, -0.5]], dtype=np.float32)
    )


def test_history_is_oldest_first_and_begins_with_the_first_frame_repeated():
    observation, readings = built(term("goal_from_tool", history=3), term("joint_position"), robots=1)
    seen = []
    for k in range(5):
        readings.now["goal_from_tool"][:] = k
        readings.now["joint_position"][:] = -k
        seen.append(observation.step()[0, :9:3].tolist())
        assert observation.frames[0, 9:].tolist() == [-k] * 6
    assert seen == [[0, 0, 0], [0, 0, 1], [0, 1, 2], [1, 2, 3], [2, 3, 4]]


@settings(max_examples=50)
@given(
    values=arrays(float, (12, 2, 3), elements=st.floats(-10, 10)),
    history=st.integers(1, 5),
    reset_at=st.integers(0, 11),
)
def test_equals_a_plain_list_of_frames(values, history, reset_at):
    observation, readings = built(term("joint_position"), term("goal_from_tool", history=history))
    kept = [[], []]
    for k, value in enumerate(values):
        if k == reset_at:
            observation.reset(np.array([False, True]))
            kept[1] = []
        readings.now["goal_from_tool"][:] = value
        frames = observation.step()
        for robot in range(2):
            kept[robot] = [*(kept[robot] or [value[robot]] * history), value[robot]][-history:]
            expected = np.concatenate(kept[robot]).astype(np.float32)
            np.testing.assert_array_equal(frames[robot, 6:], expected)


def test_reset_affects_only_the_named_robots():
    observation, readings = built(term("goal_from_tool", history=2), robots=3)
    for k in range(3):
        readings.now["goal_from_tool"][:] = k
        observation.step()
    observation.reset(np.array([False, True, False]))
    readings.now["goal_from_tool"][:] = 9
    assert observation.step()[:, ::3].tolist() == [[2, 9], [9, 9], [2, 9]]


def test_saved_and_restored_goes_on_bit_for_bit():
    (one, readings), rng = built(term("goal_from_tool", history=4)), np.random.default_rng(0)
    other, others = built(term("goal_from_tool", history=4))
    for k in range(10):
        readings.now["goal_from_tool"][:] = rng.normal(size=(2, 3))
        one.step()
        if k == 1:
            saved = one.save()
        if k >= 2:
            if k == 2:
                other.restore(saved)
            others.now["goal_from_tool"][:] = readings.now["goal_from_tool"]
            np.testing.assert_array_equal(other.step(), one.frames)


def test_nan_stays_in_the_row_of_its_robot():
    """Hiding it would hide the fault: the action stage answers for it."""
    observation, readings = built(term("goal_from_tool", clip=(-1.0, 1.0)))
    readings.now["goal_from_tool"][:] = [[0.5, np.nan, 0.5], [0.5, 0.5, 0.5]]
    frames = observation.step()
    assert np.isnan(frames[0, 1])
    assert np.isfinite(frames[1]).all()
