"""What the report says of evidence, margins, events, heat and causes, and the schema of it all."""

import json
import re
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from eval.judge.channels import Channels
from eval.report.build import build
from eval.report.html import EVENTS_SHOWN, duration, event_cells, load_text, margin_text, plots, render
from eval.report.plots.curves import heat_plot, wear_plot
from eval.report.report_files import junit
from eval.report.schema.json_schema import SCHEMA, schema
from eval.report.schema.report_data import Report
from eval.statistics.budget import load_budget
from eval.statistics.numbers import figure
from support.arm6 import SPEC
from support.eval.reports import BUNDLE, HOURS, ROBOTS, TICKS, Page, rendered, report, soak

CHANNELS = Channels.of_robot(SPEC)
HARD = sum(monitor.hard for monitor in CHANNELS.monitors)


def words(found):
    """What the page says; figures take long and say nothing here."""
    none = {"timeline": "", "margins": "", "goals": "", "heat": [""] * SPEC.n, "wear": [""] * 4}
    with patch("eval.report.html.plots", lambda _: none):
        return " ".join("".join(Page(render(found)).words).split())


def with_events(result, robots, monitor="velocity"):
    """An event of a monitor's first channel for each of `robots`, counted and not listed."""
    np.add.at(result.counts.events, (robots, result.counts.columns(monitor).start), 1)
    return build(result, load_budget())


def test_summary_bounds_a_soak_without_events():
    found = report().evidence
    # ln 20 for hours that are alike; facts: 3.63 for 16 draws that differ.
    assert found.hard_rate_upper == pytest.approx(np.log(20) / 128)
    assert found.draw_rate_upper == pytest.approx(3.63 / 128, rel=2e-3)
    assert found.hard_rate_interval == (0.0, pytest.approx(np.log(40) / 128))
    assert found.draw_rate_interval[1] > found.hard_rate_interval[1]
    assert [(f.mtbf_h, f.hours) for f in found.further] == [
        (100.0, pytest.approx(100 * np.log(20) - 128)),
        (1000.0, pytest.approx(1000 * np.log(20) - 128)),
    ]
    assert (found.family, found.family_confidence) == (HARD, pytest.approx(1 - 0.05 / HARD))
    assert found.dispersion_p == 1.0
    said = words(report())
    assert (
        "of 100 h needs 172 more hours of operating time without another event; of 1,000 h needs 2,868 more"
        in said
    )
    assert f"{HARD} hard monitors were evaluated" in said
    assert "Fewer than two hard events cannot show whether draws differ" in said


def test_further_hours_with_and_without_more_events():
    (hundred, _) = report(["velocity"]).evidence.further
    # 4.74 and 6.30 times: facts.
    assert (hundred.hours, hundred.same_rate_hours) == (
        pytest.approx(474 - 128, abs=1),
        pytest.approx(630 - 128, abs=1),
    )
    assert (
        "346 more hours of operating time without another event, or 502 if as many events occur again"
        in words(report(["velocity"]))
    )


def test_a_mean_time_that_is_shown_needs_no_more_hours():
    found = build(soak(robots=64), load_budget())
    assert [f.hours for f in found.evidence.further] == [0.0, pytest.approx(1000 * np.log(20) - 512)]
    assert "of 100 h is shown; of 1,000 h needs 2,484 more" in words(found)


@pytest.mark.parametrize(
    ("robots", "said"),
    [
        (
            [3] * 12,
            "Draws differ: chance alone spreads 12 hard events over 16 draws this unevenly in 0.01 % of cases.",
        ),
        (
            range(16),
            "Draws were not shown to differ: chance alone spreads 16 hard events over 16 draws this unevenly",
        ),
    ],
)
def test_the_test_of_over_dispersion_is_one_sentence(robots, said):
    found = with_events(soak(), list(robots))
    assert found.evidence.dispersion.startswith(said)
    assert (found.evidence.dispersion_p <= 0.05) == said.startswith("Draws differ")
    assert found.evidence.dispersion in words(found)
    # Its bound is wider where draws differ, and never narrower.
    assert found.evidence.draw_rate_upper > found.evidence.hard_rate_upper * (
        2 if len(set(robots)) == 1 else 1
    )


def test_monitor_without_budget_is_marked():
    free = load_budget().model_copy(update={"latches_max": None, "availability_min": 0.0})
    result = soak(interrupted=True)
    result.counts.latches[2] = 1234
    found = build(result, free)
    assert Report.model_validate_json(found.model_dump_json()) == found
    assert re.search(r"latches passed 1,234 no limit times", words(found))
    assert re.search(r"availability passed 100.00 % no limit", words(found))
    assert "latches: found 1234 times, no limit" in junit(found)


def test_each_monitor_has_its_bounds():
    rows = {row.name: row for row in report(["velocity"]).monitors}
    hit = rows["velocity"]
    # Garwood's limits of one event: 0.0253 and 5.572; one-sided 4.744.
    assert hit.rate_interval == (pytest.approx(0.0253 / 128, rel=2e-3), pytest.approx(5.572 / 128, rel=1e-3))
    assert hit.rate_upper == pytest.approx(4.744 / 128, rel=1e-3)
    assert hit.rate_upper < hit.draw_rate_upper < hit.family_rate_upper
    assert {row.hard for row in rows.values() if row.family_rate_upper is None} == {False}
    assert rows["jerk"].family_rate_upper > np.log(HARD / 0.05) / 128


def test_monitor_without_evaluations_has_no_bound():
    result = soak()
    result.counts.limits[result.counts.columns("observation")] = np.inf
    found = build(result, load_budget()).monitors
    (row,) = (row for row in found if not row.evaluations)
    assert (row.name, row.rate_upper, row.draw_rate_upper, row.rate_interval) == (
        "observation",
        None,
        None,
        (0.0, None),
    )


@pytest.mark.parametrize(
    ("value", "said"),
    [(0.0000512, "0.000051"), (0.5, "0.5"), (1234.5, "1,234"), (99.6, "100"), (3.0, "3"), (None, "–")],
)
def test_figures_have_no_exponents(value, said):
    assert figure(value, 2) == said


def test_margins_are_distributions():
    result = soak(["tracking"])
    result.counts.bins[result.counts.columns("tracking").start, 125] += 10
    found = build(result, load_budget())
    rows = {row.name: row for row in found.monitors}
    assert (rows["tracking"].load_histogram[70], rows["tracking"].load_histogram[125]) == (600, 10)
    assert sum(rows["jerk"].load_histogram) == 6 * ROBOTS * TICKS
    assert sum(rows["workspace"].load_histogram) == ROBOTS * TICKS
    picture = str(plots(found)["margins"])
    named = {row.name for row in found.monitors if f">{row.name}</text>" in picture}
    assert named == {m.name for m in CHANNELS.monitors if m.unit}
    # One stroke for each bin in use: two of each monitor inside the limit, one of one beyond it.
    strokes = {
        c: sum(p.count("M ") for p in picture.split("<path ") if f"stroke: var({c}); stroke-opacity" in p)
        for c in ("--series-1", "--warn")
    }
    assert strokes == {"--series-1": 2 * len(named), "--warn": 1}


@pytest.mark.parametrize("hours", [8.0, 0.69, 0.025, 0.0125])
def test_time_labels_lie_inside_the_figure(hours):
    heat, wear = report().heat[0], report().wear[0]
    ends = {"median_c": (20.0, 30.0), "hottest_c": (20.0, 40.0)}
    for picture in (
        heat_plot((0.0, hours), heat.model_copy(update=ends), 120.0),
        wear_plot((0.0, hours), wear.model_copy(update={"median": (1.0, 2.0), "most_worn": (1.0, 3.0)})),
    ):
        width = float(re.search(r'viewBox="0 0 ([\d.]+) ', picture)[1])
        labels = re.findall(r'text-anchor: middle[^>]*? x="([\d.]+)"[^>]*>([\d.]+)</text>', picture)
        at, last = max((float(x), label) for x, label in labels)
        assert float(last) > hours / 2
        assert at + 0.64 * 9 / 2 * (len(last) - 0.5 * ("." in last)) < width  # as wide as digits ever are


def test_unjudged_ticks_have_no_margin():
    result = soak()
    result.counts.invalid[4] = 12
    result.counts.bins[:, 0] += 12
    assert {row.load_histogram[0] for row in build(result, load_budget()).monitors} == {0}


def test_a_report_without_loads_has_no_margins():
    result = soak()
    result.counts.bins[:] = 0
    found = build(result, load_budget())
    assert {row.load_histogram for row in found.monitors} == {()}
    assert "Margins of every monitor" not in rendered(found)


def test_an_event_is_linked_from_its_joint_and_to_its_bundle():
    found = build(
        replace(soak(["velocity", "jerk"]), bundles=(BUNDLE, "events/0003-00720001-jerk")), load_budget()
    )
    assert {event.monitor: event.bundle for event in found.events} == {"velocity": BUNDLE, "jerk": None}
    page = Page(rendered(found))
    assert f"{BUNDLE}/" in page.loads
    assert f"soak-replay {BUNDLE}" in words(found)
    assert [load for load in page.loads if load.startswith("events/")] == [f"{BUNDLE}/"]
    links = [load[1:] for load in page.loads if load.startswith("#events")]
    assert len(links) == 2
    assert set(links) <= set(page.ids)


def busy(robots, each):
    """A night in which every channel of every robot has so many events, where an arm has it."""
    result = soak(robots=robots)
    limited = np.flatnonzero(np.isfinite(result.counts.limits))
    robot, channel, which = (x.ravel() for x in np.meshgrid(range(robots), limited, range(each)))
    start = (which * 977_777 + robot * 3571 + channel * 311) % TICKS
    log = {
        "robot": robot,
        "channel": channel,
        "start": start,
        "last": start + 9,
        "worst": 1.1 + 0.001 * channel,
    }
    result.counts.events[:, limited] = each
    return replace(result, counts=replace(result.counts, **{f"log_{name}": x for name, x in log.items()}))


@pytest.mark.slow
def test_soak_with_many_events_stays_readable_and_small():
    found = build(busy(64, 4), load_budget())
    text = rendered(found)
    assert len(text) < 10_000_000
    shown = [event for row in event_cells(found).values() for cell in row.values() for event in cell.shown]
    assert EVENTS_SHOWN / 2 < len(shown) <= EVENTS_SHOWN
    page = Page(text)
    linked = {load[1:] for load in page.loads if load.startswith("#events")}
    assert len(linked) == sum(len(CHANNELS.joints) if each.per_joint else 1 for each in CHANNELS.monitors)
    assert linked <= set(page.ids)
    assert "251 more in report.json" in words(found)


def test_an_event_with_a_bundle_is_shown_before_others():
    night = busy(16, 4)
    last = max(night.counts.log(), key=lambda e: e.start if e.monitor.name == "velocity" else 0)
    place = f"events/{last.robot:04}-{last.start:08}-velocity"
    found = build(replace(night, bundles=(place,)), load_budget())
    assert event_cells(found)["velocity"][last.joint].shown[0].bundle == place


def test_the_hottest_draw_is_named():
    result = soak()
    result.counts.bad_ticks[9, result.counts.columns("heat_soft").start + 2] = 1000
    elbow = build(result, load_budget()).heat[2]
    assert (elbow.peak_c, elbow.hottest_robot, elbow.longest_robot) == (80.0, 5, 9)
    said = words(build(result, load_budget()))
    assert "Hottest robot: 5, elbow at 80 °C." in said
    assert "above soft limit 5 s, longest robot 9: 5 s" in said


def test_folded_back_current_is_reported():
    """Half of it for a quarter of the night, of one robot of 16; another's simulation diverged by then."""
    result = soak(samples=400)
    result.folded_back[300:, 4, 1] = 0.5
    result.folded_back[100:, 7] = np.nan
    shoulder = build(result, load_budget()).heat[1]
    assert (shoulder.folded_back, shoulder.folded_most, shoulder.folded_robot) == (0.125 / 16, 0.125, 4)
    assert "current reduced by 0.8 % because of heat, robot 4 by 12.5 %" in words(
        build(result, load_budget())
    )
    assert "folded" not in words(build(soak(), load_budget()))


@pytest.mark.parametrize(
    ("hours", "said"), [(0.0, "0 s"), (0.001, "3.6 s"), (0.5, "30 min"), (2.0, "2 h"), (345.0, "345 h")]
)
def test_durations_are_formatted(hours, said):
    assert duration(hours) == said


def test_a_parameter_that_explains_failures_is_named():
    result = soak()
    rng = np.random.default_rng(1)
    others = {f"x{k}": rng.uniform(size=ROBOTS) for k in range(20)}
    result = replace(result, parameters={**result.parameters, **others})
    result.counts.reached[:] -= np.arange(ROBOTS) ** 2
    found = build(result, load_budget())
    best = found.sensitivity.causes[0]
    assert (best.parameter, best.outcome, best.rho) == ("payload.mass_kg", "goals missed", pytest.approx(1.0))
    assert best.p <= 0.01 < min(cause.p for cause in found.sensitivity.causes[1:])
    assert (found.sensitivity.draws, found.sensitivity.parameters) == (16, 21)
    assert (found.sensitivity.outcomes, len(found.sensitivity.causes)) == (("goals missed",), 10)
    assert found.sensitivity.statement.endswith("1 is, the strongest: goals missed with payload.mass_kg.")
    assert found.sensitivity.statement in words(found)
    assert "more goals missed" in words(found)


def test_insignificant_parameters_are_not_named():
    result = soak()
    result.counts.stops[[2, 9]] = 1
    found = build(result, load_budget()).sensitivity
    assert found.statement.endswith("None is: all correlations below may be chance.")
    assert 0.4 < found.noticeable < 0.7
    clean = report().sensitivity
    assert (clean.causes, clean.noticeable) == ((), None)
    assert clean.statement.startswith("No failures to explain")
    few = soak(robots=3)
    few.counts.stops[1] = 1
    assert (
        build(few, load_budget()).sensitivity.statement
        == "With 3 draws and 1 parameters, no correlation can be significant."
    )


def test_draws_that_never_ran_are_excluded():
    result = soak()
    result.counts.running[4] = result.counts.ticks[5] = result.counts.attempted[5] = 0
    result.counts.reached[[2, 9]] -= 7
    result.counts.reached[5] = 0
    assert build(result, load_budget()).sensitivity.draws == 14


def test_every_draw_has_a_row():
    result = soak(["velocity", "tracking"])
    result.stops[60:, 3] += 1
    result.latches[90:, 3] += 1
    result.counts.stops[3] = result.counts.latches[3] = 1
    found = build(result, load_budget()).robots
    assert [row.robot for row in found] == list(range(ROBOTS))
    hit = found[3]
    assert (hit.hours, hit.judged_hours, hit.running_hours) == (HOURS, HOURS, HOURS)
    assert (hit.hard_events, hit.soft_events, hit.stops, hit.latches) == (1, 1, 1, 1)
    assert (hit.stopped_h, hit.latched_h) == ((1.0,), (1.5,))
    assert (hit.goals_due, hit.goals_reached) == (7200, 7200)


def test_packaged_schema_equals_the_report_schema():
    assert SCHEMA.read_text(encoding="utf-8") == schema(), "run: python -m eval.report.schema.json_schema"


def lists_in(core):
    """Yield the lists of any length in a schema of pydantic's core."""
    if isinstance(core, dict):
        if core.get("type") == "tuple" and core.get("variadic_item_index") is not None:
            yield core
        for part in core.values():
            yield from lists_in(part)
    elif isinstance(core, list):
        for part in core:
            yield from lists_in(part)


def test_a_wrong_report_is_read_up_to_the_first_wrong_item_of_each_list():
    """Reports may be large, and each wrong item takes memory."""
    found = [*lists_in(Report.__pydantic_core_schema__)]
    assert len(found) > 20
    assert all(each.get("fail_fast") for each in found)


def test_the_schema_explains_every_record():
    found = json.loads(schema())
    assert found["properties"].keys() == Report.model_fields.keys()
    assert all(each.get("description") for each in (found, *found["$defs"].values()))
    assert not re.search(r"fir\w*shift/|/tmp|/home", schema())


@pytest.mark.parametrize(
    ("load", "said", "left"),
    [
        (0.254, "25 %", "75 %"),
        (1.43, "143 %", "−43 %"),
        (9.99, "999 %", "−899 %"),
        (12818.72, "12,819 ×", "−12,818 ×"),
        (10.4, "10 ×", "−940 %"),
        (None, "∞", "−∞"),
    ],
)
def test_loads_are_formatted(load, said, left):
    assert (load_text(load), margin_text(load)) == (said, left)
