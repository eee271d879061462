import numpy as np
import pytest

from deploy.safety.escalation import StopEscalation
from support.arm6 import SPEC

N, WINDOW = SPEC.margins.stops_max, round(SPEC.margins.stops_s / SPEC.dt)
NONE, BOTH = np.zeros(2, dtype=np.int64), np.array([True, True])


def stops(escalation, ticks, progress=NONE, begins=BOTH):
    """Return what the stops at the given ticks led to, (T, B)."""
    return np.array([escalation.step(int(tick), begins, progress) for tick in ticks])


@pytest.mark.parametrize(("last", "expected"), [(WINDOW - 1, True), (WINDOW, False)])
def test_as_many_stops_within_the_window_are_too_many(last, expected):
    ticks = [*np.linspace(0, 1000, N - 1), last]
    *before, last = stops(StopEscalation(SPEC, 2), ticks)
    assert not np.any(before)
    assert last.tolist() == [expected, expected]


def test_window_slides():
    """Oracle: count the stops of the last window, over random histories."""
    rng = np.random.default_rng(0)
    ticks = np.cumsum(rng.integers(1, 2 * WINDOW // N, 400))
    found = stops(StopEscalation(SPEC, 2), ticks)[:, 0]
    expected = [np.sum((ticks > tick - WINDOW) & (ticks <= tick)) >= N for tick in ticks]
    assert 0 < np.sum(expected) < len(ticks)
    np.testing.assert_array_equal(found, expected)


def test_progress_forgives():
    escalation = StopEscalation(SPEC, 2)
    assert not stops(escalation, range(N - 1)).any()
    assert stops(escalation, [N], progress=np.array([1, 0])).tolist() == [[False, True]]


def test_robots_are_counted_apart_and_saved():
    escalation = StopEscalation(SPEC, 2)
    stops(escalation, range(N - 1), begins=np.array([True, False]))
    other = StopEscalation(SPEC, 2)
    other.restore(escalation.save())
    assert stops(other, [N]).tolist() == [[True, False]]


def test_arming_forgives():
    escalation = StopEscalation(SPEC, 2)
    stops(escalation, range(N - 1))
    escalation.reset(np.array([True, False]))
    assert stops(escalation, [N]).tolist() == [[False, True]]
