"""The night on paper: bars cover what happened, and nothing else."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.report.build import build
from eval.report.plots.bars import timeline_plot
from eval.report.schema.rows import EventRow
from eval.report.sections.timeline import STEPS, bars, timeline
from eval.statistics.budget import load_budget
from support.eval.reports import TICKS, rendered, report, soak

ROBOTS, END_H = 5, 8.0
STEP = END_H / STEPS
# Begin and length in halves of a step, and a quarter: no span ends where a step does.
SPAN = st.tuples(
    st.integers(0, ROBOTS - 1), st.integers(0, 2 * STEPS + 2), st.sampled_from([0, 1, 2, 9, 300])
)


@settings(max_examples=60)
@given(st.lists(SPAN, max_size=12))
def test_bars_are_the_steps_that_spans_touch(drawn):
    expected = np.zeros((ROBOTS, STEPS), dtype=bool)
    for robot, begin, length in drawn:
        for half in range(begin, begin + length + 1):
            expected[robot, min(half // 2, STEPS - 1)] = True
    spans = np.array([(r, a / 2 + 0.25, (a + n) / 2 + 0.25) for r, a, n in drawn]).reshape(-1, 3)
    found = bars(spans * (1, STEP, STEP), ROBOTS, STEP)
    again = np.zeros_like(expected)
    for robot, begin, end in found:
        again[int(robot), round(begin / STEP) : round(end / STEP)] = True
    np.testing.assert_array_equal(again, expected)
    assert all(a[0] < b[0] or b[1] - a[2] > STEP / 2 for a, b in pairwise(found))


def event(robot, hard, start_h, length_s=0.05):
    unknown = {"monitor": "jerk", "joint": None, "worst": 1.1, "margin": -1.0, "unit": "m", "bundle": None}
    return EventRow(robot=robot, hard=hard, start_h=start_h, length_s=length_s, **unknown)


def test_each_kind_has_its_bars():
    result = soak()
    result.stops[120:, 4] += 1
    result.stops[121:, 4] += 1
    result.latches[300:, 6] += 1
    result.counts.invalid[7] = TICKS // 2
    result.counts.bins[:, 0] += TICKS // 2
    rows = build(result, load_budget()).robots
    night = timeline(rows, [event(1, True, 3.01), event(1, False, 5.0, 3600.0)], 8.0)
    assert len(night.judged) == len(rows)
    np.testing.assert_allclose(night.diverged, [(7, 4.0, 8.0)])
    np.testing.assert_allclose(night.hard, [(1, 3.0, 3.0 + STEP)])
    np.testing.assert_allclose(night.soft, [(1, 5.0, 6.0 + STEP)])
    np.testing.assert_allclose(night.stops, [(4, 2.0 - STEP, 2.0 + STEP)])
    np.testing.assert_allclose(night.latches, [(6, 5.0 - STEP, 5.0)])
    assert len(night.unlisted) == 0


def test_time_from_which_events_are_only_counted():
    result = soak(["velocity", "torque"])
    place = result.counts.columns("velocity").start
    result.counts.events[3, place] += 600
    result.counts.events[11, place + 1] += 1
    found = build(result, load_budget())
    assert [row.unlisted_h for row in found.robots] == [1.0 if k in {3, 11} else None for k in range(16)]
    np.testing.assert_allclose(timeline(found.robots, (), 8.0).unlisted, [(3, 1.0, 8.0), (11, 1.0, 8.0)])
    assert "events not listed one by one" in rendered(found)


def drawn(found):
    end_h = max(row.hours for row in found.robots)
    return timeline_plot(timeline(found.robots, found.events, end_h), end_h)


@pytest.mark.parametrize("robots", [1, 16, 256])
def test_every_row_is_drawn_and_the_figure_stays_small(robots):
    picture = drawn(build(soak(robots=robots), load_budget()))
    (lived,) = [
        path for path in picture.split("<path ") if "stroke: var(--line); stroke-opacity: 0.55" in path
    ]
    assert lived.count("M ") == robots
    assert ">robot</text>" in picture
    assert len(picture) < 100_000


def test_hard_events_are_drawn_over_everything():
    picture = drawn(report(["velocity", "tracking"]))
    soft, hard = (picture.rindex(f"stroke: var({colour})") for colour in ("--warn", "--bad"))
    assert picture.index("stroke: var(--line); stroke-opacity") < soft < hard
