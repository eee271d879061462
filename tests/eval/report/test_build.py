"""The report: what it says, that it is whole, safe and self-contained, and how it is written."""

import os
import re
import signal

import numpy as np
import pytest
from junitparser import JUnitXml

from deploy.operation.interrupts import handled, interrupt
from eval.judge.channels import Channels
from eval.judge.counts import REASON_NAMES
from eval.report import report_files
from eval.report.build import CURVE_POINTS, build
from eval.report.html import decimals
from eval.report.plots.curves import wear_plot
from eval.report.report_files import check_report_folder, junit, write_report
from eval.report.schema.report_data import Report
from eval.statistics.budget import load_budget
from robots.errors import OutputError
from support.arm6 import SPEC
from support.eval.reports import HOURS, ROBOTS, TICKS, Page, rendered, report, soak

HARD = [monitor for monitor in Channels.of_robot(SPEC).monitors if monitor.hard]


def test_clean_soak_passes_with_its_bound():
    found = report()
    assert found.verdict == "passed"
    assert found.statement == (
        "0 hard events in 128 hours of operating time over 16 draws: rate ≤ 0.023 per hour (≤ 0.028 where draws"
        " differ), P(bad draw) ≤ 0.17 (each with 95 % confidence), availability 100.00 %, goals reached 100.00 %."
    )
    assert found.exposure.evaluations == ROBOTS * TICKS
    assert all(row.evaluations == ROBOTS * TICKS for row in found.monitors)


@pytest.mark.parametrize("monitor", HARD, ids=lambda m: m.name)
def test_hard_event_fails_and_appears_everywhere(monitor):
    found = report([monitor.name])
    assert found.verdict == "failed"
    assert (found.evidence.hard_events, found.evidence.bad_draws) == (1, 1)
    assert [line.name for line in found.budget if not line.passed] == [monitor.name]
    row = next(row for row in found.monitors if row.name == monitor.name)
    assert (row.events, row.bad_draws, row.channels[0].worst) == (1, 1, 1.25)
    assert [(e.monitor, e.robot, e.start_h, e.length_s) for e in found.events] == [
        (monitor.name, 3, 1.0, 0.05)
    ]


def test_margins_are_shown_without_events():
    found = report()
    row = next(row for row in found.monitors if row.name == "tracking")
    # Of 92 million ticks 100 lie at 0.7, fewer than 1 in 10,000, and the others at 0.4.
    assert {channel.tail for channel in row.channels} == {0.41}
    words = " ".join("".join(Page(rendered(found)).words).split())
    assert "without 1 in 10000" in words
    assert "59 %" in words


def test_event_shows_the_margin_to_its_limit():
    (event,) = report(["velocity"]).events
    assert (event.worst, event.unit) == (1.25, "rad/s")
    assert event.margin == pytest.approx(-0.25 * SPEC.joints[0].qd_max)


def test_dropped_events_are_counted_and_reported():
    result = soak(["velocity"])
    result.counts.events[3, result.counts.columns("velocity").start] = 701
    found = build(result, load_budget())
    assert next(row for row in found.monitors if row.name == "velocity").unlisted == 700
    assert "700 more were counted above but are not listed" in rendered(found)


def test_policy_without_training_statistics_is_not_judged_by_them():
    result = soak()
    result.counts.limits[result.counts.columns("observation")] = np.inf
    found = build(result, load_budget())
    row = next(row for row in found.monitors if row.name == "observation")
    assert (row.evaluations, row.channels[0].limit) == (0, None)
    assert any("Monitors without a known limit: observation." in line for line in found.limitations)
    assert Report.model_validate_json(found.model_dump_json()) == found


def test_time_above_the_soft_limit():
    result = soak()
    place = result.counts.columns("heat_soft").start + 2
    result.counts.bad_ticks[3, place], result.counts.bad_ticks[5, place] = 720_000, 1_440_000
    elbow = build(result, load_budget()).heat[2]
    assert (elbow.above_soft_h, elbow.longest_h) == (3.0, 2.0)


def test_soft_events_are_shown_and_do_not_fail():
    found = report(["position_requested", "heat_soft"])
    assert found.verdict == "passed"
    assert {event.monitor for event in found.events} == {"position_requested", "heat_soft"}
    assert found.evidence.bad_draws == 0


def test_heat_keeps_the_hottest_and_the_median():
    found = report(samples=5 * CURVE_POINTS)
    assert len(found.sample_h) == CURVE_POINTS
    elbow = found.heat[2]
    assert elbow.hottest_c[-1] == 75.0
    assert elbow.median_c[0] == 25.0
    assert (elbow.joint, elbow.soft_c, elbow.max_c) == ("elbow", 80.0, 110.0)


def test_unseen_limits_follow_from_the_counts():
    result = soak()
    result.counts.worst[:] = 0.9
    result.counts.worst[:, result.counts.columns("torque")] = 0.2
    result.counts.invalid[4] = 12
    result.counts.bins[:, 0] += 12
    text = " ".join(build(result, load_budget()).limitations)
    assert "used to 50 %: torque." in text
    assert "12 ticks of the 1 robots whose simulation diverged" in text
    assert "1 of 16 draws bad, up to 26 % of all possible draws may be bad" in text
    assert "no faults were scheduled" in text
    assert text.endswith("no real robot was tested.")


@pytest.mark.slow
def test_json_round_trips(tmp_path):
    found = report(["jerk"])
    assert Report.model_validate_json(found.model_dump_json()) == found
    write_report(found, tmp_path)
    again = Report.model_validate_json((tmp_path / "report.json").read_text())
    assert rendered(again) == (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("events", [(), ("jerk", "workspace", "position_requested")])
def test_page_is_valid_small_and_self_contained(events):
    text = rendered(report(events))
    page = Page(text)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert all(load.startswith(("#", "data:,")) for load in page.loads)
    assert {load[1:] for load in page.loads if load.startswith("#")} <= set(page.ids)
    assert not re.search(r"@import|url\((?!#)|<script|https?://(?!www\.w3\.org)", text)
    assert text.count("<svg") == SPEC.n + 4 + 1 + 2
    assert len(text) < 1_000_000
    assert "prefers-color-scheme: dark" in text
    assert not re.search(r"#0[1-6]0[1-6]0[1-6]", text)


def test_page_shows_the_report():
    found = report(["velocity"])
    words = " ".join("".join(Page(rendered(found)).words).split())
    assert found.statement in words
    assert "Failed" in words
    assert "Budget exceeded: velocity." in words
    for row in found.monitors:
        assert row.name in words
        assert row.meaning in words
    for said in (
        *SPEC.joint_names,
        *found.limitations,
        "92,160,000",
        "a" * 64,
        "b" * 64,
        "soak-test --seed 7",
    ):
        assert said in words


def test_interruption_is_shown_everywhere():
    found = report(["jerk"], interrupted=True, ticks=TICKS // 4)
    words = " ".join("".join(Page(rendered(found)).words).split())
    assert found.verdict == "interrupted"
    assert "Interrupted after 2 of 8 hours" in words
    assert "Budget exceeded so far: jerk." in words
    (suite,) = JUnitXml.fromstring(junit(found))
    assert (suite.failures, suite.skipped, suite.tests) == (1, len(found.budget) - 1, len(found.budget))


def test_hostile_name_is_escaped():
    text = rendered(report(policy="<script>alert(1)</script>"))
    assert "<script" not in text
    assert "&lt;script&gt;" in text


@pytest.mark.parametrize(("ticks", "samples"), [(0, 1), (1, 1), (1, 2)])
@pytest.mark.slow
def test_very_short_run_has_a_report(ticks, samples):
    result = soak(ticks=ticks, samples=samples, interrupted=True)
    empty = np.zeros(0, dtype=np.int64)
    object.__setattr__(result, "goals_attempted", empty)
    object.__setattr__(result, "goals_reached", empty)
    found = build(result, load_budget())
    Page(rendered(found))
    assert "no bound" in found.statement if ticks == 0 else "rate ≤" in found.statement


@pytest.mark.slow
def test_non_finite_numbers():
    result = soak(["velocity"])
    result.counts.worst[3, result.counts.columns("velocity").start] = np.inf
    result.winding_c[200:, 5] = np.nan
    result.winding_c[300:] = np.nan
    found = build(result, load_budget())
    assert found.heat[2].hottest_c[-1] is None
    assert found.heat[2].median_c[250] == pytest.approx(25 + 35 * 250 / 480, abs=0.2)
    result.worn[:] = np.nan
    worthless = build(result, load_budget())
    assert worthless.wear[0].median[-1] is worthless.wear[0].joints[3].median[1] is None
    for each in (found, worthless):
        assert Report.model_validate_json(each.model_dump_json()) == each
        assert "∞" in rendered(each)


def test_wear_by_quantity_and_joint():
    result = soak()
    result.worn[:, :, 15, 5] = result.worn[:, :, 0, 0]
    found = {row.name: row for row in build(result, load_budget()).wear}
    ends = {name: (row.unit, row.median[0], row.median[-1], row.most_worn[-1]) for name, row in found.items()}
    assert ends == {
        "friction": ("%", 100.0, 110.0, 119.0),
        "backlash": ("mrad", 0.3, 0.4, 0.49),
        "encoder error": ("mrad", 0.0, 1.0, 1.9),
        "torque constant": ("%", 100.0, 99.0, 98.1),
    }
    for row in found.values():
        assert (row.robot, row.joint) == (14, "wrist_3")
        assert row.most_worn[240] == pytest.approx((row.most_worn[0] + row.most_worn[-1]) / 2, abs=1e-3)
        assert [each.joint for each in row.joints] == list(SPEC.joint_names)
        assert [each.robot for each in row.joints] == [15, 15, 15, 15, 15, 14]
    elbow = found["torque constant"].joints[2]
    assert (elbow.median, elbow.most_worn) == ((100.0, 99.05), (100.0, 98.3))


def test_most_worn_joint_has_the_longest_travel_and_a_known_end():
    result = soak()
    result.worn[:, 1, 3] += 0.005
    result.worn[300:, :, 15] = np.nan
    found = {row.name: row for row in build(result, load_budget()).wear}
    assert {(row.robot, row.joint) for row in found.values()} == {(14, "wrist_3")}
    assert found["friction"].joints[0].median == (100.0, 107.0)
    assert found["friction"].median[0] == 100.0


@pytest.mark.slow
def test_the_page_shows_the_wear():
    found = report()
    words = " ".join("".join(Page(rendered(found)).words).split())
    assert found.goals.change in words
    for row in found.wear:
        assert f"{row.name.capitalize()}, {row.unit}" in words
        assert row.meaning in words
        for each in row.joints:
            for start, end in (each.median, each.most_worn):
                assert f"{decimals(start, row.unit)} → {decimals(end, row.unit)}" in words
    assert "100.0 → 107.5 100.0 → 115.0 0.30 → 0.38 0.30 → 0.45 0.00 → 0.75" in words
    for name in ("Friction", "Backlash", "Encoder error", "Torque constant"):
        assert f'aria-label="{name} over time"' in rendered(found)


def test_axis_of_negligible_wear_spans_one_percent():
    friction = report().wear[0]
    hardly = friction.model_copy(update={"median": (100.0, 100.001), "most_worn": (100.0, 100.002)})
    ticks = re.findall(r">([\d.]+)</text>", wear_plot((0.0, 8.0), hardly))
    assert {"100", "101"} <= set(ticks)


def changed(reached, attempted=1000, hours=HOURS):
    result, bins = soak(samples=round(60 * hours) + 1), len(reached)
    object.__setattr__(result, "sample_h", np.linspace(0, hours, round(60 * hours) + 1))
    object.__setattr__(result, "goals_attempted", np.broadcast_to(np.int64(attempted), bins).copy())
    object.__setattr__(result, "goals_reached", np.array(reached, dtype=np.int64))
    return build(result, load_budget()).goals


@pytest.mark.parametrize(
    ("reached", "verdict"),
    [
        ([990, 0, 990], "overlap: no change is shown."),
        ([990, 990, 980], "overlap: no change is shown."),
        ([980, 990, 990], "overlap: no change is shown."),
        ([990, 990, 960], "do not overlap: the end is worse than the start."),
        ([960, 990, 990], "do not overlap: the end is better than the start."),
    ],
)
def test_end_is_compared_with_the_start_statistically(reached, verdict):
    assert changed(reached).change.endswith(f". The 95 % intervals {verdict}")


def test_the_comparison_names_its_hours_and_leaves_bins_without_goals_out():
    found = changed([0, 990, 0, 495, 0], attempted=[0, 1000, 0, 500, 0], hours=4.5)
    assert found.change.startswith(
        "Goals reached from hour 1 to 2: 99.00 % (98.17 to 99.52 %) of 1,000;"
        " from hour 3 to 4: 99.00 % (97.68 to 99.67 %) of 500."
    )
    assert (found.bins[1].low, found.bins[1].high) == pytest.approx((0.9817, 0.9952), abs=1e-4)
    assert (found.bins[-1].start_h, found.bins[-1].end_h) == (4.0, 4.5)


@pytest.mark.parametrize("reached", [[], [990]])
def test_one_bin_cannot_be_compared(reached):
    assert changed(reached).change.startswith("All goals were in one part of the soak")


def test_stops_by_reason():
    result = soak()
    result.counts.stops[2], result.counts.latches[2] = 3, 1
    result.counts.reasons[2, REASON_NAMES.index("WORKSPACE")] = 2
    result.counts.reasons[2, REASON_NAMES.index("NONE")] = 1
    found = build(result, load_budget())
    assert (found.stops.total, found.stops.latches) == (3, 1)
    assert found.stops.reasons == {"NONE": 1, "WORKSPACE": 2}
    assert "No robot stopped" in rendered(report())
    assert 'workspace<div class="what">the tool would leave its workspace' in rendered(found)


def test_one_test_case_for_each_budget_line():
    found = report(["tool_speed"])
    (suite,) = JUnitXml.fromstring(junit(found))
    assert [case.name for case in suite] == [line.name for line in found.budget]
    failed = [case for case in suite if not case.is_passed]
    assert [(case.name, case.result[0].message) for case in failed] == [
        ("tool_speed", "tool_speed: found 1 events, allowed at most 0")
    ]


@pytest.mark.slow
def test_an_older_report_is_replaced_and_nothing_is_left_over(tmp_path):
    write_report(report(["jerk"]), tmp_path / "a" / "b")
    write_report(report(), tmp_path / "a" / "b")
    assert {path.name for path in (tmp_path / "a" / "b").iterdir()} == {
        "report.json",
        "report.html",
        "junit.xml",
    }
    assert '"passed"' in (tmp_path / "a" / "b" / "report.json").read_text()


@pytest.mark.parametrize("attempt", [check_report_folder, lambda out: write_report(report(), out)])
def test_unwritable_folder_is_refused(tmp_path, attempt):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match="file"):
        attempt(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "mine"


def test_a_signal_between_two_files_leaves_no_old_one(tmp_path, monkeypatch):
    monkeypatch.setattr(report_files, "FILES", {name: lambda text: text for name in ("a", "b", "c")})
    write_report("old", tmp_path)

    def interrupted(source, target, *, replace=os.replace):
        replace(source, target)
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt), handled(interrupt):
        write_report("new", tmp_path)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys("abc", "new")


@pytest.mark.slow
def test_failed_write_keeps_all_old_files(tmp_path):
    write_report(report(["jerk"]), tmp_path)
    before = (tmp_path / "report.json").read_text()
    (tmp_path / "junit.xml").unlink()
    (tmp_path / "junit.xml").mkdir()
    with pytest.raises(OutputError, match=r"junit\.xml"):
        write_report(report(), tmp_path)
    assert (tmp_path / "report.json").read_text() == before
    assert {path.name for path in tmp_path.iterdir()} == {"report.json", "report.html", "junit.xml"}


def test_folder_in_place_of_a_report_file_is_an_error_before_the_soak(tmp_path):
    (tmp_path / "report.html").mkdir()
    with pytest.raises(OutputError, match=r"report\.html: found a folder"):
        check_report_folder(tmp_path)


def test_claim_creates_the_folder_only(tmp_path):
    check_report_folder(tmp_path / "new")
    assert list((tmp_path / "new").iterdir()) == []
