"""soak-report, over soaks as they were lived."""

from functools import partial

import numpy as np
import pytest

from support.eval.nights import LATER, night
from support.eval.reports import Page
from support.policies import policy_model, saved

pytest.importorskip("mujoco")

from eval.history.history import add_record
from eval.history.soak_record import Run
from eval.report.build import build
from eval.report.cli import cli
from eval.report.html import interval_text
from eval.report.report_files import write_report
from eval.shard.shard import Shard
from eval.soak.assembly import assemble
from eval.statistics.budget import load_budget
from eval.statistics.compare import compare
from eval.statistics.dispersion import draw_rate_interval
from support.eval.soaks import soak_config

RUN = Run(started="2026-01-01T00:00:00+00:00", wall_s=1.0, hours=0.001, resumed_hours=0.0, interrupted=False)


def soaked(path):
    """4.7 s of 3 robots, as soak-test reports them."""
    soak = soak_config(path, hours=0.0013, robots=3)
    (job,) = soak.jobs()
    shard = Shard(job).run(lambda ticks: None, lambda: False)
    return build(assemble(soak, [shard], RUN), load_budget())


@pytest.fixture
def soak_report(call, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    return partial(call, cli)


@pytest.mark.slow
def test_two_policies_on_the_same_draws(soak_report, arm_policy, tmp_path):
    """One does nothing, the other throws the arms about: a report's folder, and a night that was kept."""
    idle, restless = soaked(arm_policy), soaked(saved(policy_model(), tmp_path))
    write_report(idle, tmp_path / "idle")
    code, said, _ = soak_report("compare", tmp_path / "idle", add_record(restless, tmp_path / "history"))
    assert code == 0
    assert (
        f"A: {idle.settings.policy} ({idle.settings.policy_digest[:12]}) on 3 draws of seed 3, 0.0013 h"
        in said
    )
    for each in compare(idle.per_draw_counts, restless.per_draw_counts):
        (line,) = [line for line in said.splitlines() if each.name in line]
        per = 1.0 if each.unit else 100.0
        numbers = [
            float(x) for x in line.replace("−", "-").split() if x.lstrip("-").replace(".", "").isdigit()
        ]
        shown = [per * x for x in (each.a, each.b, each.b - each.a, each.low, each.high)]
        np.testing.assert_allclose(numbers[:5], shown, atol=6e-4)
        assert f"{each.differing} of 3" in line
    assert sum(restless.per_draw_counts.stops) > sum(idle.per_draw_counts.stops) == 0
    assert idle.per_draw_counts.ticks == restless.per_draw_counts.ticks == (936,) * 3
    assert restless.results_digest != idle.results_digest == idle.sealed()


def test_digest_of_results_excludes_run_details():
    one = night(1)
    otherwise = {"started": RUN.started, "wall_s": 9.0, "resumed_hours": 2.0}
    again = one.model_copy(update={"run": one.run.model_copy(update=otherwise)})
    assert (
        again.sealed() == night(1, workers=5, command="make soak", policy="b.onnx").sealed() == one.sealed()
    )
    others = (night(2), night(1, rate=0.4), night(1, verdict="failed"), night(1, hours=8.5))
    assert len({each.sealed() for each in (one, *others)}) == 5


@pytest.fixture
def refused(soak_report):
    def attempt(*words):
        code, said, complaint = soak_report(*words)
        assert (code, said) == (2, "")
        return complaint

    return attempt


def test_other_draws_are_refused(refused, tmp_path):
    a, b = add_record(night(1), tmp_path), add_record(night(2), tmp_path)
    assert refused("compare", a, b) == f"error: {b}: seed: found 2, but {a} has 1\n"
    code = add_record(night(1, code_digest="z9"), tmp_path)
    assert refused("compare", a, code) == f"error: {code}: code_digest: found z9, but {a} has c1\n"


def test_malformed_report_is_refused(refused, tmp_path):
    (tmp_path / "report.json").write_text("{}")
    assert f"error: {tmp_path / 'report.json'}: format: Field required" in refused(
        "compare", tmp_path, tmp_path
    )
    assert f"error: {tmp_path / 'gone'}: cannot be read" in refused("compare", tmp_path / "gone", tmp_path)


def test_a_link_in_a_history_is_not_written_through(soak_report, refused, tmp_path):
    """It may be a folder of somebody else; a link that the user names is followed."""
    history, mine = tmp_path / "history", tmp_path / "mine"
    add_record(night(1), history)
    mine.write_text("kept")
    (history / "trend.html").symlink_to(mine)
    assert refused("trend", history) == f"error: --out {history}/trend.html: found a link, expected no link\n"
    assert mine.read_text() == "kept"
    assert soak_report("trend", history, "--out", history / "trend.html")[0] == 0
    assert mine.read_text().startswith("<!doctype html>")


def test_a_trend_is_a_page_and_its_sentences(soak_report, tmp_path):
    for seed, started in ((1, LATER), (2, "2026-01-04T22:00:00+01:00")):
        add_record(night(seed, started=started), tmp_path / "history")
    code, said, _ = soak_report("trend", tmp_path / "history")
    assert code == 0
    assert "over 32 draws of 2 soaks" in said
    assert ("2026-01-03 22:00" in said, "2026-01-04 22:00" in said) == (True, True)
    events, hours = night(1).per_draw_counts.hard_events
    assert "per h, 95 %" in said
    assert interval_text(tuple(map(float, draw_rate_interval(events, hours)))) in said
    page = tmp_path / "history" / "trend.html"
    assert said.endswith(f"page: {page}\n")
    assert Page(page.read_text()).open == []
    assert soak_report("trend", tmp_path / "history", "--out", tmp_path / "a" / "b.html")[0] == 0
    assert (tmp_path / "a" / "b.html").read_bytes() == page.read_bytes()


def test_paths_are_printed_as_they_are(soak_report, tmp_path):
    folder = tmp_path / "[/x]\n"
    add_record(night(1, policy="[/y]"), folder)
    code, said, _ = soak_report("trend", folder)
    assert code == 0
    assert "1: [/y] (" in said
    assert f"page: {tmp_path}/[/x]?/trend.html\n" in said


def test_no_nights_are_refused(refused, tmp_path):
    said = refused("trend", tmp_path)
    assert said == f"error: {tmp_path}: found no records, expected some from soak-test --history\n"
    folder = tmp_path / "nowhere"
    assert refused("trend", folder).startswith(f"error: {folder}: found no records")
    folder = tmp_path / ("x" * 300)
    assert refused("trend", folder) == f"error: {folder}: cannot be read: File name too long\n"


def test_unwritable_page_is_reported(refused, tmp_path):
    add_record(night(1), tmp_path)
    assert "error: --out /dev/null/trend.html" in refused("trend", tmp_path, "--out", "/dev/null/trend.html")


@pytest.mark.parametrize("words", [(), ("forecast",), ("compare", "a")])
def test_unknown_command_exits_with_2(soak_report, words):
    assert soak_report(*words)[0] == 2
