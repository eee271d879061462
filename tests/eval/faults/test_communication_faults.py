"""Answers of a slow arm to lost commands, reboots, late ticks and a changed tool, in a short shard.

What the same faults do at full speed is in docs/faults.md.
"""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from deploy.policy.policy import Policy
from deploy.reasons import Reason
from eval.faults.fault_class import StopCategory
from eval.faults.fault_response import saved_responses
from eval.faults.schedule import FaultSettings
from eval.judge.monitors import NAMES
from eval.shard import shard as shards
from eval.shard.job import WIDTH, ShardJob
from eval.shard.shard import Shard
from support.arm6 import SPEC
from support.eval.fault_schedules import CLASSES, named, one_each
from support.policies import policy_model, saved

BEGINS, TICKS = 120, 120 + 460
SLOW = 0.25
"""Factor of the policy's actions: the arm moves at 0.75 rad/s when faults begin."""
ANSWERS = {
    "bus loses 25 ms": (StopCategory.NO_STOP, Reason.NONE),
    "bus silent": (StopCategory.CATEGORY_1, Reason.STALE | Reason.LOST | Reason.DIVERGED | Reason.TRACKING),
    "bus delays": (StopCategory.CATEGORY_1, Reason.STALE | Reason.LOST | Reason.DIVERGED | Reason.TRACKING),
    "computer stalls": (StopCategory.NO_STOP, Reason.NONE),
    "computer hangs": (StopCategory.CATEGORY_1, Reason.OVERRUN),
    "joint drive reboots": (StopCategory.CATEGORY_1, Reason.LOST),
    "controller reboots": (StopCategory.CATEGORY_1, Reason.LOST),
    "robot tool changed": (StopCategory.NO_STOP, Reason.NONE),
}
"""Answer and reasons, of which at least one holds."""
CATCHES_UP = "bus loses 25 ms"
"""Its drives make up for the way that was lost with all of their torque, which is a hard event."""


@pytest.fixture
def shard(tmp_path, monkeypatch):
    """A shard of a policy that moves slowly, in which two robots get each of these faults."""
    path = saved(policy_model(), tmp_path)
    faults = [(named(name), None if None in named(name).channels else 1) for name in ANSWERS] * 2
    monkeypatch.setattr(shards, "plan", lambda *_: one_each(faults, BEGINS))
    digests = {"robot_digest": SPEC.digest, "policy_digest": Policy.load(path, SPEC).digest}
    job = ShardJob(
        robot=SPEC.folder,
        policy=path,
        seed=3,
        first=0,
        robots=WIDTH,
        ticks=TICKS,
        sample_ticks=TICKS,
        **digests,
    )
    shard = Shard(replace(job, faults=FaultSettings(coverage=0.95, cycle_s=20.0, operator_s=5.0)))
    said = shard.injector.action
    shard.injector.action = lambda action, call: said((SLOW * action).astype(np.float32), call)
    return shard


def test_each_fault_gets_its_answer_and_only_lost_commands_take_all_of_the_torque(shard):
    reasons = np.zeros(WIDTH, dtype=np.int64)
    for _ in range(TICKS):
        shard.tick()
        reasons |= np.where(shard.runtime.supervisor.running, 0, shard.runtime.supervisor.reason)
    found = saved_responses(shard.responses.save(), WIDTH)
    for robot, (name, (answer, reason)) in enumerate([*ANSWERS.items()] * 2):
        assert found.answer[robot, 0] == answer, name
        assert bool(reasons[robot] & reason) == (reason != Reason.NONE), name
        assert CLASSES[found.class_index[robot, 0]].name == name
        torque = bool(found.violated[robot, 0] & 1 << NAMES.index("torque"))
        assert torque == (name == CATCHES_UP), name
    counts = shard.judge.counts()
    hard = {monitor.name for monitor in counts.channels.catalogue if monitor.hard}
    assert {name for name in hard if counts.total(name)} == {"torque"}
