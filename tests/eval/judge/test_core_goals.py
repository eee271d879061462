"""Goals that a task counts apart: by the judge, in the report, and not at all for other tasks."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from deploy.tasks.reach import Reach
from deploy.tasks.success import CoreGoals
from eval.judge.counts import merge
from eval.judge.judge import Judge
from eval.report.build import build
from eval.statistics.budget import load_budget
from robots.errors import ConfigError
from support.arm6 import SPEC
from support.eval.judges import OBSERVED, TORQUE_MAX, Bench
from support.eval.reports import Page, rendered, report, soak

HIGH = CoreGoals("above 0.5 m", lambda goal: goal[:, 2] > 0.5)
CRITERION = replace(Reach.success_criterion(SPEC), core=HIGH)


def bench(robots, criterion=CRITERION):
    made = Bench(robots)
    made.judge = Judge(SPEC, TORQUE_MAX, robots, criterion=criterion, observed=OBSERVED)
    return made


def played(made, seed=0, goals=40):
    """Random goals of some robots, half of them reached: (goals, robots) heights, reached."""
    rng = np.random.default_rng(seed)
    robots = len(made.goal)
    height, reached = rng.uniform(0.2, 0.8, (goals, robots)), rng.random((goals, robots)) < 0.5
    for now, near in zip(height, reached, strict=True):
        made.goal[:, 2] = now
        made.truth.tool_position[:] = made.goal + np.where(near, 0.0, 0.1)[:, None]
        made.step(2)
        made.attempted += 1
        made.step()
    return height, reached


def test_core_goals_are_counted_apart():
    made = bench(3)
    height, reached = played(made)
    counts, core = made.judge.counts(), height > 0.5
    assert counts.reached.tolist() == reached.sum(axis=0).tolist()
    assert counts.core_attempted.tolist() == core.sum(axis=0).tolist()
    assert counts.core_reached.tolist() == (core & reached).sum(axis=0).tolist()
    assert counts.core_success == (core & reached).sum() / core.sum()
    assert counts.core_goals == "above 0.5 m"


def test_a_robot_that_does_not_run_reaches_no_core_goal():
    made = bench(1)
    made.powered[:] = False
    made.mode[:] = 0
    height, _ = played(made)
    counts = made.judge.counts()
    assert (counts.core_attempted[0], counts.core_reached[0]) == ((height > 0.5).sum(), 0)


def test_core_counts_are_saved_and_merged():
    whole, first, second = bench(1), bench(1), bench(1)
    played(whole, seed=1)
    played(first, seed=1)
    second.judge.restore(first.judge.save())
    both = merge(whole.judge.counts(), second.judge.counts())
    assert both.core_attempted.tolist() == [whole.judge.counts().core_attempted[0]] * 2
    assert both.core_reached[0] == both.core_reached[1] > 5
    with pytest.raises(ConfigError, match="core_goals"):
        merge(whole.judge.counts(), Bench(1).judge.counts())


def test_a_task_without_core_goals_counts_none_and_reports_none():
    counts = Bench(2).judge.counts()
    assert counts.core_goals == ""
    assert not counts.core_attempted.any()
    found = report()
    assert found.goals.core is None
    assert "Goals " not in found.statement
    assert "Success in these" not in rendered(found)


def test_the_report_shows_both_rates():
    result = soak()
    counts = replace(
        result.counts,
        core_goals="above 0.5 m",
        core_attempted=np.full(16, 1000),
        core_reached=np.full(16, 990),
    )
    found = build(replace(result, counts=counts), load_budget())
    core = found.goals.core
    assert (core.meaning, core.attempted, core.reached, core.success) == ("above 0.5 m", 16_000, 15_840, 0.99)
    assert core.low < 0.99 < core.high
    assert found.statement.endswith("Goals above 0.5 m reached: 99.00 %.")
    words = " ".join(" ".join(Page(rendered(found)).words).split())
    assert "Goals above 0.5 m 15,840 of 16,000" in words
    assert "Success in these 99.00 %" in words
