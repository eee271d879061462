"""How nights follow each other: numbers against direct computation, and the pages that show them."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from eval.report.html import interval_text, render_history
from eval.report.plots.curves import TREND_QUANTITIES
from eval.report.schema.report_data import Report
from eval.report.schema.trend_rows import Trend
from eval.report.sections.trend import THIS_RUN, trend
from eval.statistics.dispersion import dispersion_p, draw_rate_interval, draw_rate_upper
from eval.statistics.evidence import rate_upper, share_upper
from eval.statistics.numbers import figure
from support.eval.nights import OTHER, named, night
from support.eval.reports import Page, rendered, report

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
B, C = OTHER["policy_digest"], {**OTHER["policy_digest"], **OTHER["code_digest"], **OTHER["numpy"]}


def year():
    """Two nights of one policy, two of another, one of which twice, and one of another code and numpy."""
    changes = [(1, {}), (2, {}), (1, B), (2, B), (2, B), (3, C)]
    return named(
        *(
            night(seed, started=f"2026-01-0{k + 1}T22:00:00+00:00", **each)
            for k, (seed, each) in enumerate(changes)
        )
    )


def bounded(events, hours):
    return tuple(float(end) for end in draw_rate_interval(events, hours))


def test_a_night_is_the_sum_of_its_draws():
    (row,) = trend(named(night(1))).runs
    per_draw_counts = night(1).per_draw_counts
    events = np.sum([*per_draw_counts.hard.values()], axis=0)
    hours = np.array(per_draw_counts.running) / 720_000
    assert (row.hard_events, row.bad_draws) == (events.sum(), (events > 0).sum())
    assert row.running_hours == pytest.approx(hours.sum())
    assert row.rate.value == pytest.approx(events.sum() / hours.sum())
    assert (row.rate.low, row.rate.high) == pytest.approx(bounded(events, hours))
    assert row.goals.value == pytest.approx(sum(per_draw_counts.reached) / sum(per_draw_counts.due))
    missed = np.subtract(per_draw_counts.due, per_draw_counts.reached)
    assert (1 - row.goals.high, 1 - row.goals.low) == pytest.approx(bounded(missed, per_draw_counts.due))
    assert row.availability.value == pytest.approx(sum(per_draw_counts.running) / sum(per_draw_counts.ticks))
    low, high = np.multiply(24_000, bounded(np.array(per_draw_counts.stops) / 2, per_draw_counts.ticks))
    assert (1 - row.availability.high, 1 - row.availability.low) == pytest.approx((low, high))
    assert (row.hottest_c.value, row.hottest_c.low) == (
        max(per_draw_counts.hottest_c),
        np.median(per_draw_counts.hottest_c),
    )


def test_nights_of_one_identity_are_pooled_and_each_draw_counts_once():
    nights = year()
    found = trend(nights)
    assert [row.group for row in found.runs] == [0, 0, 1, 1, 1, 2]
    assert [row.repeated for row in found.runs] == [False] * 4 + [True, False]
    assert [row.name for row in found.runs] == list(nights)
    assert [(group.runs, group.draws) for group in found.groups] == [(2, 32), (2, 32), (1, 16)]
    assert [group.changed for group in found.groups] == [(), ("policy",), ("code", "numpy")]
    one, two = (nights[f"night-{k}.json"].per_draw_counts.hard_events for k in (0, 1))
    events, hours = np.append(one[0], two[0]), np.append(one[1], two[1])
    bad = int((events > 0).sum())
    for group in found.groups[:2]:
        assert (group.hard_events, group.bad_draws) == (events.sum(), bad)
        assert group.rate_upper == pytest.approx(float(rate_upper(events.sum(), hours.sum())))
        assert group.draw_rate_upper == pytest.approx(float(draw_rate_upper(events, hours)))
        assert group.bad_draw_upper == pytest.approx(float(share_upper(bad, 32)))
        assert group.dispersion_p == dispersion_p(events, hours)


def test_night_with_most_draws_counts_among_equal_seeds():
    found = trend(named(night(1), night(1, draws=32), night(1, draws=32), night(2)))
    assert [row.repeated for row in found.runs] == [True, False, True, False]
    assert (found.groups[0].runs, found.groups[0].draws) == (2, 48)


def test_groups_may_recur():
    found = trend(named(night(1), night(2, **B), night(3)))
    assert [row.group for row in found.runs] == [0, 1, 0]
    assert found.last.runs == 2


def test_the_sentence_of_several_nights():
    quiet = trend(named(*(night(seed, rate=0.0) for seed in (1, 2))))
    said = re.sub(r"in [\d.]+ hours", "in T hours", quiet.groups[0].statement)
    assert said == (
        "0 hard events in T hours of operating time over 32 draws of 2 soaks: rate ≤ 0.012 per hour (≤ 0.013 where"
        " draws differ), P(bad draw) ≤ 0.089 (each with 95 % confidence), availability 99.92 %, goals reached 97.97 %."
    )
    assert quiet.groups[0].dispersion.startswith("Fewer than two hard events cannot show")
    assert "draws of 1 soak: " in trend(named(night(1))).groups[0].statement


def test_overdispersion_of_draws_is_reported():
    usual = night(2, rate=1.0)
    assert trend(named(usual)).groups[0].dispersion.startswith("Draws were not shown to differ")
    lumps = usual.per_draw_counts.model_copy(
        update={"hard": usual.per_draw_counts.hard | {"jerk": (60, *(0,) * 15)}}
    )
    found = trend(named(usual.model_copy(update={"per_draw_counts": lumps}))).groups[0]
    assert found.dispersion_p < 0.001
    assert found.dispersion.startswith("Draws differ: ")


def changed(**columns):
    usual = night(1)
    return trend(
        named(usual.model_copy(update={"per_draw_counts": usual.per_draw_counts.model_copy(update=columns)}))
    )


def test_availability_without_stops_has_no_bound():
    still = changed(stops=(0,) * 16, running=(5_759_960,) * 16).runs[0].availability
    assert (still.value, still.low, still.high) == (pytest.approx(5_759_960 / 5_760_000), None, None)


def test_robots_that_never_ran_have_no_numbers():
    nothing = changed(running=(0,) * 16, due=(0,) * 16, reached=(0,) * 16, hottest_c=(None,) * 16)
    row, group = nothing.runs[0], nothing.groups[0]
    assert row.rate.value is row.goals.value is row.hottest_c.value is group.rate_upper is None
    assert row.availability.value == 0.0
    assert "no bound on the rate, P(bad draw)" in group.statement
    Page(render_history(nothing, night(1).settings.task))


@pytest.mark.parametrize("shape", [0.5, 5.0])
def test_goals_of_draws_that_differ_are_covered(shape):
    """Each robot misses by a chance of its own; 2 % on average."""
    rng = np.random.default_rng(1)
    due = np.full(16, 900.0)
    missed = rng.binomial(900, rng.beta(shape, 49 * shape, (4000, 16)))
    low, high = draw_rate_interval(missed.T, due)
    assert np.mean((low <= 0.02) & (high >= 0.02)) >= 0.94


def test_json_holds_the_trend():
    whole = report().model_copy(update={"trend": trend({**year(), THIS_RUN: report()})})
    assert Report.model_validate_json(whole.model_dump_json()) == whole
    assert Trend.model_validate_json(whole.trend.model_dump_json()) == whole.trend
    assert whole.trend.runs[-1].name == THIS_RUN


def words(page):
    return " ".join("".join(Page(page).words).split())


@pytest.mark.slow
def test_trend_is_shown_only_with_a_history():
    whole = report().model_copy(update={"trend": trend({**year(), THIS_RUN: report()})})
    page, bare = rendered(whole), rendered(report())
    assert page.count("<svg") == bare.count("<svg") + len(TREND_QUANTITIES)
    last = whole.trend.last
    assert f"{last.statement} {last.dispersion}" in words(page)
    assert "over 16 draws of 1 soak" in last.statement
    assert "Trend" not in words(bare)
    ids = Page(page).ids
    assert len(ids) == len(set(ids))


def test_page_of_nights_is_valid_and_self_contained():
    nights = year()
    nights["night-1.json"] = nights["night-1.json"].model_copy(update={"verdict": "failed"})
    found = trend(nights)
    text = render_history(found, night(1).settings.task)
    page, said = Page(text), words(text)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert all(load.startswith(("#", "data:,")) for load in page.loads)
    assert not re.search(r"@import|url\((?!#)|<script|https?://(?!www\.w3\.org)", text)
    assert text.count("<svg") == len(TREND_QUANTITIES) == 4
    assert not re.search(r"#0[1-6]0[1-6]0[1-6]", text)
    assert found.groups[-1].statement in said
    assert "2 repeated" in said
    assert (text.count('<span class="chip ok">'), text.count('<span class="chip no">')) == (5, 1)
    for each in found.runs:
        assert each.started[:16].replace("T", " ") in said
        assert f"{figure(each.rate.value, 2)}{interval_text((each.rate.low, each.rate.high))}" in said
    for key, value in night(1).settings.task.items():
        assert f"{key.replace('_', ' ').capitalize()} {value}" in re.sub(
            r"(?<=\w)(?=a1|d1|f1|arm6|8|none)", " ", said
        )


def test_hostile_name_is_escaped():
    text = render_history(trend(named(night(1, policy="<script>"))), night(1).settings.task)
    assert "<script" not in text


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium")
@pytest.mark.slow
def test_browser_renders_every_plot_without_errors(tmp_path):
    page = tmp_path / "trend.html"
    page.write_text(render_history(trend(year()), night(1).settings.task))
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--dump-dom")
    done = subprocess.run(
        [CHROMIUM, *options, f"--user-data-dir={tmp_path / 'profile'}", page.as_uri()],
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert done.stdout.count("<svg") == len(TREND_QUANTITIES)
    assert "CONSOLE" not in done.stderr
