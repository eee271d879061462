"""What is made of an injection: hand-made stories, and a shard that goes on in the midst of faults."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from deploy.policy.policy import Policy
from deploy.state import Mode
from eval.faults.fault_class import StopCategory
from eval.faults.fault_response import (
    NOT_RUNNING,
    SETTLE_S,
    FaultResponseTracker,
    merge_responses,
    saved_responses,
)
from eval.faults.schedule import FaultSettings
from eval.judge.monitors import NAMES
from eval.mutants.guard_removal import ignore_non_finite_action
from eval.mutants.situation import keep_guards
from eval.report.sections.faults import fault_line, fault_table
from eval.shard import shard as shards
from eval.shard.job import WIDTH, ShardJob
from eval.shard.shard import Shard
from eval.statistics.evidence import share_lower
from robots.models.nominal_model import torque_max
from support.arm6 import SPEC, arm_judge
from support.eval.fault_schedules import CLASSES, DT, N, named, one_each
from support.policies import policy_model, saved
from support.quadruped import QUADRUPED

FAULTS = FaultSettings(coverage=0.95, cycle_s=20.0, operator_s=5.0)
RUN, STOP, HOLD, LATCHED = Mode.RUNNING, Mode.STOPPING, Mode.HOLDING, Mode.LATCHED
SOFT = SPEC.model_copy(update={"base": QUADRUPED.base})
BEGINS, SETTLE = 10, round(SETTLE_S / DT)


def told(fault, story, *, lasts=50, speed=0.0, hurt=None, before=RUN, spec=SPEC):
    """What is found of one injection.

    The story is a list of (ticks, mode, true speed); `speed` is the one sent. `hurt` is a tick at which it collides.
    """
    schedule = one_each([(fault, None)], BEGINS, lasts=lasts)
    tracker, judge = FaultResponseTracker(spec, schedule), arm_judge(torque_max(SPEC), 1)
    still, tick = np.zeros((1, N)), BEGINS
    tracker.begin(tick, np.array([before]), judge)
    for ticks, mode, moves in story:
        for _ in range(ticks):
            if tick - BEGINS == hurt:
                judge.events.bad_ticks[0, judge.counts().columns("self_collision")] += 1
            sent = np.full((1, N), speed if mode in (RUN, STOP) else 0.0)
            command = SimpleNamespace(q=still, qd=sent, powered=np.array([mode != LATCHED]))
            truth = SimpleNamespace(q=still + 0.01 * (moves > 0), qd=still + moves)
            if tracker.following:
                tracker.step(tick, truth, command, np.array([mode]), judge)
            tick += 1
    found = saved_responses(tracker.save(), 1)
    return SimpleNamespace(**{name: getattr(found, name)[0, 0] for name in found.__slots__}), found


def row(found, fault):
    table = fault_table(SPEC, SPEC.sensors, FAULTS, found)
    return next(
        each for each in table.rows if (each.where, each.what) == (fault.component, fault.failure_mode)
    )


def test_unnoticed_fault_without_violation_is_handled():
    fault = named("force off")
    one, found = told(fault, [(400, RUN, 0.5)])
    assert (one.answer, one.stopped, one.rest, one.resumed) == (StopCategory.NO_STOP, -1, -1, 0)
    assert one.complete == 50 + SETTLE
    assert row(found, fault).handled == 1
    one, found = told(fault, [(400, RUN, 0.5)], hurt=49)
    assert one.violated == 1 << NAMES.index("self_collision")
    assert (row(found, fault).injections, row(found, fault).handled) == (1, 0)
    assert row(found, fault).violations == {"self_collision": 1}


def test_violations_before_or_after_do_not_count():
    fault = named("force off")
    one, found = told(fault, [(400, RUN, 0.5)], hurt=50 + SETTLE + 1)
    assert (one.violated, row(found, fault).handled) == (0, 1)


def test_hold_time_is_from_injection_to_true_rest():
    fault = named("force off")
    one, found = told(
        fault, [(7, RUN, 0.5), (20, STOP, 0.4), (3, HOLD, 0.2), (60, HOLD, 0.0), (200, RUN, 0.1)]
    )
    assert (one.answer, one.stopped, one.rest) == (StopCategory.CATEGORY_2, 7, 30)
    assert one.resumed == 90 - 50
    assert one.complete == 90 + SETTLE
    assert one.tracking_error == pytest.approx(0.01)
    found = row(found, fault)
    assert (found.stopped.median_s, found.at_rest.worst_s, found.resumed) == (7 * DT, 30 * DT, 1)
    assert (found.handled, found.answers) == (1, {"category 2": 1})


def test_too_severe_response_is_not_handled():
    story = [(5, RUN, 0.5), (10, STOP, 0.4), (100, LATCHED, 0.0), (200, RUN, 0.1)]
    for name, handled in (("force off", 0), ("encoder off", 1)):
        one, found = told(named(name), story)
        assert one.answer == StopCategory.CATEGORY_1
        assert row(found, named(name)).handled == handled
    (fault,) = fault_table(SPEC, SPEC.sensors, FAULTS, told(named("force off"), story)[1]).unhandled
    assert (fault.fault, fault.answer, fault.channel, fault.violations) == (
        "force off",
        "category 1",
        None,
        (),
    )
    assert (fault.stopped_s, fault.at_rest_s) == (5 * DT, 15 * DT)


@pytest.mark.parametrize(
    ("spec", "before", "speed", "true", "answer"),
    [
        (SPEC, RUN, 0.5, 0.0, StopCategory.CATEGORY_0),
        (SPEC, STOP, 0.5, 0.0, StopCategory.CATEGORY_0),
        (SPEC, RUN, 0.0, 0.5, StopCategory.CATEGORY_1),  # it vibrates
        (SOFT, RUN, 0.0, 0.5, StopCategory.CATEGORY_0),
        (SOFT, STOP, 0.0, 0.5, StopCategory.CATEGORY_0),
        (SOFT, STOP, 0.0, 0.0, StopCategory.CATEGORY_1),
    ],
)
def test_power_loss_in_motion_is_category_0(spec, before, speed, true, answer):
    """Of drives that follow what they are sent, and of soft ones."""
    story = [(5, before, true), (300, LATCHED, 0.0), (200, RUN, 0.1)]
    one, found = told(named("encoder off"), story, speed=speed, spec=spec)
    assert one.answer == answer
    assert row(found, named("encoder off")).handled == (answer == StopCategory.CATEGORY_1)


def test_robot_without_recovery_is_followed_to_the_end_of_its_slot():
    one, found = told(named("encoder off"), [(5, STOP, 0.4), (2_100, LATCHED, 0.0)])
    assert (one.resumed, one.complete) == (-1, 2_000)
    assert (row(found, named("encoder off")).resumed, row(found, named("encoder off")).injections) == (0, 1)


def test_idle_robot_does_not_count():
    one, found = told(named("encoder off"), [(400, RUN, 0.0)], before=LATCHED)
    assert one.began == NOT_RUNNING
    assert (row(found, named("encoder off")).injections, row(found, named("encoder off")).not_running) == (
        0,
        1,
    )


def test_unfinished_response_does_not_count():
    _, found = told(named("encoder off"), [(20, RUN, 0.0)])
    assert row(found, named("encoder off")).injections == 0


def test_budget_line_is_the_worst_class():
    """One of each class handled, of the last one 59: still all others are shown too seldom."""
    fault = named("force off")
    _, found = told(fault, [(400, RUN, 0.5)])
    many = merge_responses([found] * 59)
    table = fault_table(SPEC, SPEC.sensors, FAULTS, many)
    assert row(many, fault).handled_lower == pytest.approx(float(share_lower(59, 59)))
    assert (fault_line(table).found, fault_line(table).passed) == (0.0, False)
    alone = table.model_copy(update={"rows": (row(many, fault),)})
    assert fault_line(alone).passed
    missed = merge_responses([found] * 58 + [told(fault, [(400, RUN, 0.5)], hurt=3)[1]])
    assert not fault_line(table.model_copy(update={"rows": (row(missed, fault),)})).passed


@pytest.fixture
def restless(tmp_path, monkeypatch):
    """A shard of a policy that throws the arms about, each with another fault from tick 70 to 570."""
    path = saved(policy_model(), tmp_path)
    names = (
        "encoder stuck",
        "encoder intermittent",
        "policy stalls",
        "joint housing hot",
        "joint winding short",
    )
    names += ("joint blocked", "robot cable caught", "robot supply sags", "bus silent", "bus delays")
    names += (
        "controller reboots",
        "computer late",
        "encoder slips",
        "robot tool changed",
        "robot two faults",
    )
    faults = [(named(name), None if None in named(name).channels else 1) for name in names]
    faults += [None] * (WIDTH - len(faults))
    monkeypatch.setattr(shards, "plan", lambda *_: one_each(faults, 70, lasts=500))
    digests = {"robot_digest": SPEC.digest, "policy_digest": Policy.load(path, SPEC).digest}
    job = ShardJob(
        robot=SPEC.folder, policy=path, seed=3, first=0, robots=WIDTH, ticks=800, sample_ticks=100, **digests
    )
    return replace(job, faults=FAULTS.model_copy(update={"operator_s": 0.5}))


@pytest.mark.slow
def test_shard_resumed_during_faults_is_bit_identical(restless):
    whole, first, second = (Shard(restless) for _ in range(3))
    whole.run(lambda _: None, lambda: False)
    seen, kept = [], []
    first.run(seen.append, lambda: seen[-1] >= 400, lambda: kept.append(first.save()))
    assert int(kept[-1]["runtime.ticks"]) == 400
    second.restore(kept[-1])
    result = second.run(lambda _: None, lambda: False)
    a, b = second.save(), whole.save()
    assert a.keys() == b.keys()
    for name, array in a.items():
        np.testing.assert_array_equal(array, b[name], err_msg=name)
    found = result.responses
    assert (found.began[:8] == 70).all()
    assert (found.stopped >= 0).sum() >= 2
    assert CLASSES[found.class_index[0, 0]].name == "encoder stuck"
    assert found.answer[0, 0] == StopCategory.CATEGORY_1


@pytest.mark.parametrize(
    ("remove_guard", "events"), [(keep_guards, [0, 0, 0]), (ignore_non_finite_action, [1, 1, 0])]
)
def test_judge_sees_the_injected_policy_output(restless, monkeypatch, remove_guard, events):
    faults = [(named("policy nan"), 1), (named("policy infinite"), 3)] + [None] * (WIDTH - 2)
    monkeypatch.setattr(shards, "plan", lambda *_: one_each(faults, 70))
    shard = Shard(restless)
    remove_guard(shard.runtime)
    for _ in range(78):
        shard.tick()
    counts = shard.judge.counts()
    assert counts.events[:3, counts.columns("action_finite")].ravel().tolist() == events
