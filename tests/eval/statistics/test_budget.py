"""Budgets: the shipped one, every way of misspelling one, and what passes."""

import numpy as np
import pytest

from eval.judge.channels import Channels
from eval.judge.monitors import MONITORS
from eval.statistics.budget import BUDGET, budget_line, check, load_budget
from robots.errors import ConfigError
from robots.spec import load_robot
from support.arm6 import arm_judge

SPEC = load_robot("arm6")
HARD = [monitor for monitor in Channels.of_robot(SPEC).monitors if monitor.hard]


def counts(events=(), *, hours=2.0, running=1.0, reached=1.0, invalid=0, latches=0):
    """Two robots' counts, with the monitors in `events` having fired on robot 0."""
    found = arm_judge(np.full(6, 100.0), robots=2).counts()
    ticks = round(hours / 2 * 3600 / found.dt)
    goals = round(hours / 2 * 900)
    found.ticks[:] = ticks
    found.running[:] = round(running * ticks)
    found.attempted[:] = goals
    found.reached[:] = round(reached * goals)
    found.invalid[1] = invalid
    found.latches[1] = latches
    for name in events:
        found.events[0, found.columns(name).start] += 1
    return found


def failed(*args, **kwargs):
    return {finding.name for finding in check(load_budget(), counts(*args, **kwargs)) if not finding.passed}


def test_clean_work_passes_and_every_limited_monitor_has_a_line():
    assert failed() == set()
    budget = load_budget()
    lines = {finding.name for finding in check(budget, counts())}
    names = {monitor.name for monitor in Channels.of_robot(SPEC).monitors}
    limited = names & {*budget.events_max, *budget.events_per_hour_max}
    assert lines == {"goal_success", "availability", "invalid", "latches", *limited}


@pytest.mark.parametrize("monitor", HARD, ids=lambda m: m.name)
def test_one_hard_event_fails(monitor):
    assert failed([monitor.name]) == {monitor.name}


@pytest.mark.parametrize(
    ("kwargs", "lines"),
    [
        ({"running": 0.98}, {"availability"}),
        ({"reached": 0.96}, {"goal_success"}),
        ({"running": 0.0, "reached": 0.0}, {"availability", "goal_success"}),
        ({"hours": 0.0}, {"availability", "goal_success"}),
        ({"invalid": 1}, {"invalid"}),
        ({"latches": 1}, {"latches"}),
        ({"events": ["tracking"], "hours": 20.0}, set()),
        ({"events": ["tracking"], "hours": 8.0}, {"tracking"}),
        ({"events": ["tracking"], "hours": 0.0}, {"availability", "goal_success", "tracking"}),
        ({"events": ["position_requested"] * 50}, set()),
    ],
)
def test_each_line_fails_for_itself(kwargs, lines):
    assert failed(**kwargs) == lines


def test_a_budget_may_leave_latches_unlimited():
    budget = load_budget(BUDGET.with_name("budget_faults.toml"))
    assert budget.latches_max is None
    (line,) = (line for line in check(budget, counts(latches=10**9)) if line.name == "latches")
    assert (line.passed, line.found, line.allowed) == (True, 1e9, None)


@pytest.mark.parametrize("at_least", [True, False])
def test_nan_does_not_pass(at_least):
    line = budget_line("goal_success", 0.97, float("nan"), "share", at_least=at_least)
    assert (line.passed, line.found) == (False, None)


TEXT = BUDGET.read_text() + "\n[events_max]\njerk = 0\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("availability_min", "availabilty_min", "availabilty_min: Extra inputs"),
        (
            "availability_min = 0.99",
            "availability_min = 99",
            "availability_min: .* less than or equal to 1, found 99",
        ),
        ("goal_success_min = 0.97", "goal_success_min = nan", "goal_success_min: .*finite"),
        ("jerk = 0", "jerk = -1", r"events_max\.jerk: .* found -1"),
        ("jerk = 0", "jerk = 0.5", r"events_max\.jerk: .* found 0\.5"),
        ("jerk = 0", "jerks = 0", "unknown monitor 'jerks'; known: .*jerk"),
        ("jerk = 0", "jerk = 0\n[events_per_hour_max]\njerk = 0.1", "monitor 'jerk' has 2 lines"),
        ("invalid_ticks_max = 0", "", "invalid_ticks_max: Field required"),
        ("latches_max = 0", "", "latches_max: Field required"),
        ("latches_max = 0", "latches_max = -1", r"latches_max: [^\n]* found -1$"),
        ("latches_max = 0", "latches_max = 'many'", r"latches_max: [^\n]* found 'many'$"),
        ("\n[events_max]\n", "\n[events_max\n", "not valid TOML"),
    ],
)
def test_a_wrong_budget_names_file_and_field(tmp_path, old, new, message):
    path = tmp_path / "budget.toml"
    assert old in TEXT
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(ConfigError, match=message) as caught:
        load_budget(path)
    assert str(path) in str(caught.value)


def test_missing_budget_file_is_reported(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.toml: cannot be read: No such file"):
        load_budget(tmp_path / "none.toml")


SENT = {"velocity_sent", "acceleration", "jerk", "torque_rate", "command_jump"}
STATE = {
    *("position_hard", "velocity", "torque", "self_collision", "contact_force", "workspace", "tool_speed"),
    *("tilt", "base_height", "fallen", "powered_fallen", "heat_hard", "action_finite"),
}
SOFT = {
    *("position_requested", "position_soft", "heat_soft", "power", "robot_power", "estimate", "observation"),
    *("tracking", "singularity"),
}


@pytest.mark.parametrize(
    ("file", "work", "none_allowed", "per_hour"),
    [
        ("budget.toml", (0.97, 0.99, 0, 0), SENT | STATE, {"tracking": 0.1, "singularity": 0.1}),
        ("budget_faults.toml", (0.0, 0.0, 0, None), SENT, {}),
    ],
)
def test_shipped_budgets_hold_the_figures_of_the_project(file, work, none_allowed, per_hour):
    """Monitors in neither table are counted without a limit. A new monitor has the bound of its declaration."""
    found = load_budget(BUDGET.with_name(file))
    bounds = found.goal_success_min, found.availability_min, found.invalid_ticks_max, found.latches_max
    assert bounds == work
    known = SENT | STATE | SOFT
    assert known <= {monitor.name for monitor in MONITORS}
    assert {n: most for n, most in found.events_max.items() if n in known} == dict.fromkeys(none_allowed, 0)
    assert {n: most for n, most in found.events_per_hour_max.items() if n in known} == per_hour


def test_a_budget_overrides_the_bounds_of_monitors(tmp_path):
    path = tmp_path / "budget.toml"
    text = (
        BUDGET.read_text()
        + "unlimited = ['jerk']\nevents_per_hour_max = {power = 2.0}\nevents_max = {tracking = 3}"
    )
    path.write_text(text)
    found = load_budget(path)
    assert "jerk" not in {*found.events_max, *found.events_per_hour_max}
    assert found.events_per_hour_max == {"power": 2.0, "singularity": 0.1}
    assert found.events_max["tracking"] == 3
    assert load_budget().events_per_hour_max == {"tracking": 0.1, "singularity": 0.1}
