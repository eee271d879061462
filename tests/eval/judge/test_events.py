"""What the judge keeps of what it found: events one by one up to a bound, loads by size, and only robots that count."""

from dataclasses import fields

import numpy as np
import pytest

from eval.judge import events as event_log
from eval.judge.counts import BINS, Counts, merge
from eval.judge.monitors import MONITORS
from support.arm6 import SPEC, arm_judge
from support.eval.judges import GAP, OBSERVED, TORQUE_MAX, Bench, feed, random_series


def flicker(bench, times):
    """So many events of a collision of robot 0, and in the first of them of the last robot's as well."""
    for k in range(times):
        bench.truth.self_collision[0], bench.truth.self_collision[-1] = True, k == 0
        bench.step()
        bench.truth.self_collision[:] = False
        bench.step(GAP)


def test_events_are_kept_up_to_a_bound_per_monitor_and_all_counted(monkeypatch):
    monkeypatch.setattr(event_log, "EVENTS_KEPT", 4)
    bench = Bench(robots=3)
    flicker(bench, 7)
    bench.truth.qd[1, 2] = 10.0
    bench.step()
    counts = bench.judge.counts()
    assert counts.total("self_collision") == 8
    assert (counts.left_out("self_collision"), counts.left_out("velocity")) == (4, 0)
    kept = [(e.robot, e.start // (GAP + 1), e.monitor.name, e.joint) for e in counts.log()]
    contact = [(0, 0), (0, 1), (0, 2), (2, 0)]
    assert sorted(kept) == sorted(
        [*((*e, "self_collision", None) for e in contact), (1, 7, "velocity", "elbow")]
    )


def test_dropped_event_changes_no_kept_event(monkeypatch):
    monkeypatch.setattr(event_log, "EVENTS_KEPT", 1)
    bench = Bench(robots=2)
    bench.truth.tool_velocity[0, 0] = 3.0
    bench.step(2)
    bench.truth.tool_velocity[:, 0] = 0.0, 9.0
    bench.step(GAP + 5)
    bench.truth.tool_velocity[0, 0] = 9.0
    bench.step(3)
    counts = bench.judge.counts()
    (kept,) = counts.log()
    assert (kept.robot, kept.start, kept.ticks, kept.worst) == (0, 0, 2, pytest.approx(1.2))
    assert counts.left_out("tool_speed") == 2


def test_kept_events_do_not_depend_on_queries(monkeypatch):
    monkeypatch.setattr(event_log, "EVENTS_KEPT", 5)
    ticks = 120
    series = random_series(ticks, 3, seed=8)
    asked, left, resumed = (arm_judge(TORQUE_MAX, 3, observed=OBSERVED) for _ in range(3))
    feed(left, series, range(ticks))
    for tick in range(ticks):
        feed(asked, series, [tick])
        asked.counts()
    feed(resumed, series, range(50))
    again = arm_judge(TORQUE_MAX, 3, observed=OBSERVED)
    again.restore(resumed.save())
    feed(again, series, range(50, ticks))
    wanted = list(left.counts().log())
    assert len(wanted) > 5 * sum(monitor.per_joint for monitor in MONITORS) / 2
    assert list(asked.counts().log()) == wanted == list(again.counts().log())


def test_tail_equals_numpy_quantile_rounded_up_to_its_bin():
    ticks, robots = 400, 3
    series = random_series(ticks, robots, seed=9)
    judge, loads = arm_judge(TORQUE_MAX, robots, observed=OBSERVED), []
    evaluate = judge.ratios.evaluate
    judge.ratios.evaluate = lambda window: loads.append(evaluate(window)) or keep(loads)
    feed(judge, series, range(ticks))
    counts = judge.counts()
    every = np.concatenate(loads, axis=1)
    valid = series["valid"].astype(bool)
    for share in (0.5, 0.1, 0.01, 1e-4):
        found = counts.tail(share)
        for channel in range(len(counts.limits)):
            known = np.nan_to_num(every[channel][valid], nan=np.inf)
            exact = np.quantile(known, 1 - share, method="inverted_cdf")
            if exact < 2.0:
                assert exact - 1e-9 <= found[channel] <= exact + 0.01 + 1e-9
            else:
                assert found[channel] == counts.worst[:, channel].max()
    assert counts.bins.shape == (len(counts.limits), BINS)
    assert (counts.bins.sum(axis=1) == ticks * robots).all()


def keep(loads):
    """Of the newest block a copy by channel (C, T, R) is kept; the block goes on."""
    block = loads[-1]
    many, ticks, wide = block.joints.shape
    robots = block.robots.shape[2]
    joints = block.joints.reshape(many, ticks, robots, wide // robots).transpose(0, 3, 1, 2)
    loads[-1] = np.concatenate((joints.reshape(-1, ticks, robots), block.robots))
    return block


def test_tail_without_samples_is_unknown():
    assert np.isnan(arm_judge(TORQUE_MAX, 1).counts().tail(1e-4)).all()


def test_robots_that_do_not_count_leave_no_trace():
    ticks = 200
    series = random_series(ticks, 4, seed=10)
    wide = arm_judge(TORQUE_MAX, 4, counted=2, observed=OBSERVED)
    narrow = arm_judge(TORQUE_MAX, 2, observed=OBSERVED)
    feed(wide, series, range(ticks))
    feed(narrow, series, range(ticks), slice(0, 2))
    for field in fields(Counts):
        np.testing.assert_array_equal(
            getattr(wide.counts(), field.name), getattr(narrow.counts(), field.name), strict=True
        )


def test_load_histograms_of_shards_add_up():
    ticks, series = 150, random_series(150, 4, seed=11)
    whole = arm_judge(TORQUE_MAX, 4, observed=OBSERVED)
    parts = [arm_judge(TORQUE_MAX, 2, observed=OBSERVED) for _ in range(2)]
    feed(whole, series, range(ticks))
    for judge, rows in zip(parts, (slice(0, 2), slice(2, 4)), strict=True):
        feed(judge, series, range(ticks), rows)
    merged = merge(parts[0].counts(), parts[1].counts())
    np.testing.assert_array_equal(merged.tail(1e-3), whole.counts().tail(1e-3))
    assert list(merged.log()) == list(whole.counts().log())
    assert {event.robot for event in merged.log()} == {0, 1, 2, 3}


@pytest.mark.parametrize(("pause", "events"), [(1, 1), (GAP - 1, 1), (GAP, 2), (3 * GAP, 2)])
def test_events_merge_over_less_than_the_gap(pause, events):
    bench = Bench()
    for ticks, load in [(3, 3.0), (pause, 0.0), (2, 2.0), (GAP, 0.0)]:
        bench.truth.qd[0, 1] = load * SPEC.joint_array("qd_max")[1]
        bench.step(ticks)
    counts = bench.judge.counts()
    logged = [(e.start, e.ticks, round(e.worst, 9), e.monitor.name, e.joint) for e in counts.log()]
    first = (0, 5 + pause if events == 1 else 3, 3.0, "velocity", "shoulder_lift")
    second = (3 + pause, 2, 2.0, "velocity", "shoulder_lift")
    assert logged == [first, second][:events]
    assert counts.total("velocity") == events
    assert counts.bad_ticks.sum() == 5
