"""Each guard taken away: every reason is covered, caught is told from missed, and the quickest are caught here."""

from dataclasses import replace

import pytest
from rich.console import Console

from support.arm6 import SPEC

pytest.importorskip("mujoco")

from deploy.command_line import BUDGET_EXCEEDED, PASSED
from deploy.state import Reason
from eval.judge.monitors import NAMES
from eval.mutants import __main__ as command
from eval.mutants import suite
from eval.mutants.mutant import INVALID, LATCHES
from eval.mutants.situation import live, nobody
from eval.mutants.suite import FURY, MUTANTS, Row, rows
from robots.errors import ConfigError

ASKED = Reason.OVERRUN | Reason.OPERATOR
"""Reasons that only the shift around a runtime has: its clock's, and the operator's own."""
QUICK = (
    "safety: collision",
    "planner: jerk",
    "action: no leash",
    "estimator: believed",
    "runtime: a robot that",
)


def named(start):
    (found,) = [mutant for mutant in MUTANTS if mutant.guard.startswith(start)]
    return found


def test_every_reason_to_stop_has_a_mutant():
    """A reason that is new has none: this fails until it gets one. An arm cannot fall: see test_walker.py."""
    weakened = Reason.FALLEN
    for mutant in MUTANTS:
        weakened |= mutant.reasons
    assert {reason for reason in Reason if reason not in ASKED} == {
        reason for reason in Reason if reason in weakened
    }


def test_guards_have_names_of_their_own_and_monitors_exist():
    assert len({mutant.guard for mutant in MUTANTS}) == len(MUTANTS)
    assert {mutant.monitor for mutant in MUTANTS} <= {*NAMES, LATCHES, INVALID}


@pytest.mark.parametrize("start", QUICK)
def test_the_judge_notices_that_a_guard_is_gone(start):
    (row,) = rows(SPEC, (named(start),))
    assert row.whole == 0
    assert row.weakened > 0
    assert row.caught


def test_a_mutant_that_weakens_nothing_is_missed():
    (row,) = rows(SPEC, (replace(named("planner: jerk"), weaken=nobody),))
    assert (row.whole, row.weakened) == (0, 0)
    assert not row.caught


@pytest.mark.parametrize(
    ("whole", "weakened", "caught"), [(0, 3, True), (0, 0, False), (2, 3, False), (None, None, False)]
)
def test_caught_is_silent_with_the_guard_and_heard_without(whole, weakened, caught):
    assert Row(mutant=MUTANTS[0], whole=whole, weakened=weakened).caught == caught


def test_with_guards_off_and_draws_doubled_every_monitor_fires():
    assert not suite.silent(SPEC)


def test_with_its_guards_the_same_fury_does_less():
    """What the test above sees is the guards' absence, not only the situation."""
    whole = live(SPEC, replace(FURY[0], befalls=cold, seconds=1.5))
    assert whole.running.min() > 0
    assert {name for name in NAMES if whole.total(name)} <= {"position_requested", "power", "robot_power"}


def cold(runtime, robot, t):
    """Motors have done nothing yet."""


def test_a_policy_that_asks_for_nothing_fails_the_budget(monkeypatch):
    monkeypatch.setattr(suite, "IDLE", replace(suite.IDLE, seconds=8.5))
    assert "goal_success" in suite.idle_fails(SPEC)


@pytest.mark.parametrize(("weakened", "code"), [(4, PASSED), (0, BUDGET_EXCEEDED)])
def test_the_command_prints_a_row_for_each_and_fails_if_one_is_missed(weakened, code, monkeypatch):
    console = Console(record=True, width=160)
    monkeypatch.setattr(command, "console", console)
    monkeypatch.setattr(command.mujoco, "set_mju_user_warning", lambda handler: None)
    monkeypatch.setattr(
        command, "rows", lambda spec, chosen: (Row(mutant=m, whole=0, weakened=weakened) for m in chosen)
    )
    assert command.mutants(only="planner: jerk") == code
    text = console.export_text()
    assert ("MISSED" in text) == (code != PASSED)
    assert ("1 of 1 caught" in text) == (code == PASSED)


def test_the_command_refuses_a_guard_that_it_does_not_know():
    with pytest.raises(ConfigError, match="safety: position, off"):
        command.mutants(only="no such guard")
