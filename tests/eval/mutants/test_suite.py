"""Each guard taken away: every reason is covered, each removal is caught, and caught is told from missed."""

from dataclasses import replace

import pytest
from rich.console import Console

from deploy.reasons import Reason
from support.arm6 import SPEC

pytest.importorskip("mujoco")

import eval.mutants.__main__ as command
from deploy.command_line import BUDGET_EXCEEDED, PASSED
from eval.judge.monitors import NAMES
from eval.mutants import suite
from eval.mutants.situation import INVALID, LATCHES, keep_guards, run_situation
from eval.mutants.suite import ALL_GUARDS_OFF, MUTANTS, Row, run_mutants
from robots.errors import ConfigError

ASKED = Reason.OVERRUN | Reason.OPERATOR
"""Reasons that only the shift around a runtime has: its clock's, and the operator's own."""
WITHOUT_LIMIT = Reason.REPEATED | Reason.OSCILLATION
"""Reasons about wear: the judge has no limit for them. See tests/deploy/test_runtime_guards.py."""


def named(start):
    (found,) = [mutant for mutant in MUTANTS if mutant.guard.startswith(start)]
    return found


def test_every_reason_to_stop_has_a_mutant():
    """A reason that is new has none: this fails until it gets one.

    An arm cannot fall: tests/deploy/test_runtime_walking.py has that of a walker.
    """
    without_guard = Reason.FALLEN | WITHOUT_LIMIT
    for mutant in MUTANTS:
        without_guard |= mutant.reasons
    assert {reason for reason in Reason if reason not in ASKED} == {
        reason for reason in Reason if reason in without_guard
    }


def test_guards_have_names_of_their_own_and_monitors_exist():
    assert len({mutant.guard for mutant in MUTANTS}) == len(MUTANTS)
    assert {mutant.monitor for mutant in MUTANTS} <= {*NAMES, LATCHES, INVALID}


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.guard)
@pytest.mark.slow
def test_judge_detects_a_missing_guard(mutant):
    (row,) = run_mutants(SPEC, (mutant,))
    assert row.with_guard == 0
    assert row.without_guard > 0
    assert row.caught


@pytest.mark.slow
def test_a_mutant_that_weakens_nothing_is_missed():
    (row,) = run_mutants(SPEC, (replace(named("planner: jerk"), remove_guard=keep_guards),))
    assert (row.with_guard, row.without_guard) == (0, 0)
    assert not row.caught


@pytest.mark.parametrize(
    ("with_guard", "without_guard", "caught"),
    [(0, 3, True), (0, 0, False), (2, 3, False), (None, None, False)],
)
def test_caught_means_silent_with_the_guard_and_an_event_without(with_guard, without_guard, caught):
    assert Row(mutant=MUTANTS[0], with_guard=with_guard, without_guard=without_guard).caught == caught


@pytest.mark.slow
def test_with_guards_off_and_draws_doubled_every_monitor_fires():
    assert not suite.silent_monitors(SPEC)


def test_guards_reduce_the_events_of_the_same_attack():
    """What the test above sees is the guards' absence, not only the situation."""
    with_guard = run_situation(SPEC, replace(ALL_GUARDS_OFF[0], disturbance=cold, seconds=1.5))
    assert with_guard.running.min() > 0
    assert {name for name in NAMES if with_guard.total(name)} <= {
        "position_requested",
        "power",
        "robot_power",
    }


def cold(runtime, robot, t):
    """Motors have done nothing yet."""


@pytest.mark.slow
def test_idle_policy_fails_the_budget(monkeypatch):
    monkeypatch.setattr(suite, "IDLE", replace(suite.IDLE, seconds=8.5))
    assert "goal_success" in suite.idle_budget_failures(SPEC)


@pytest.mark.parametrize(("without_guard", "code"), [(4, PASSED), (0, BUDGET_EXCEEDED)])
def test_command_prints_a_row_per_mutant_and_fails_if_one_is_missed(without_guard, code, monkeypatch):
    console = Console(record=True, width=160)
    monkeypatch.setattr(command, "console", console)
    monkeypatch.setattr(command.mujoco, "set_mju_user_warning", lambda handler: None)
    monkeypatch.setattr(
        command,
        "run_mutants",
        lambda spec, chosen: (Row(mutant=m, with_guard=0, without_guard=without_guard) for m in chosen),
    )
    assert command.mutants(only="planner: jerk") == code
    text = console.export_text()
    assert ("MISSED" in text) == (code != PASSED)
    assert ("1 of 1 caught" in text) == (code == PASSED)


def test_the_command_refuses_a_guard_that_it_does_not_know():
    with pytest.raises(ConfigError, match="safety: position, off"):
        command.mutants(only="no such guard")
