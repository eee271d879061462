"""Judge of a shard: its inputs after each tick, and the shard's results."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract import Contract
from deploy.runtime import Runtime
from deploy.stage import inside
from deploy.tasks.task import find_task
from deploy.truth import Truth
from eval.faults.fault_response import FaultResponses, saved_responses
from eval.judge.counts import Counts
from eval.judge.judge import Judge
from eval.shard.job import WIDTH
from robots.arrays import Floats, Ints
from robots.models.nominal_model import torque_max
from robots.spec import RobotSpec

Action = NDArray[np.floating] | None
"""(B, A) action of the policy, None in ticks between two of its steps."""
COUNTED = ("attempted", "reached", "running", "stops", "latches")
"""Running totals of `Counts` that are sampled."""
SAMPLED = ("winding_c", "worn", "folded_back", *COUNTED, "events")


def make_judge(spec: RobotSpec, contract: Contract, robots: int, *, counted: int | None = None) -> Judge:
    """Return the judge of B robots before their first tick; the first `counted` are judged, by default all."""
    criterion = find_task(contract.task, "contract: task").success_criterion(spec)
    return Judge(
        spec,
        torque_max(spec),
        robots,
        criterion=criterion,
        mode=contract.action.control_mode,
        counted=counted,
        observed=contract.observed,
    )


def judge_tick(judge: Judge, truth: Truth, runtime: Runtime, action: Action) -> None:
    """Pass the tick that has just ended, with the ground truth after it, to the judge."""
    judge.step(
        truth=truth,
        state=runtime.state,
        observation=runtime.observation.frames,
        target=runtime.target,
        action=action,
        command=runtime.command,
        mode=runtime.supervisor.mode,
        reason=runtime.supervisor.reason,
        achieved=runtime.task.true_achieved(truth),
        goal=runtime.task.goal,
        goal_number=runtime.task.number,
        attempted=runtime.task.attempted,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardResult:
    """Results of the R robots that count; samples are taken at the start and then at a fixed interval.

    Attributes:
        counts: from the judge.
        responses: to injected faults.
        winding_c: (T, R, n) °C, true winding temperature; NaN where the simulation diverged, as in the next two.
        worn: (T, 4, R, n) wear of the joints, in the order of `WornJoints`.
        folded_back: (T, R, n) share of its current that a working motor could not draw because of its heat.
        attempted, reached: (T, R) goals so far.
        running: (T, R) ticks in operation so far. stops, latches: (T, R) as in `Counts`, so far.
        events: (T, R, monitors) so far, all joints together.
    """

    counts: Counts
    responses: FaultResponses
    winding_c: Floats
    worn: Floats
    folded_back: Floats
    attempted: Ints
    reached: Ints
    running: Ints
    stops: Ints
    latches: Ints
    events: Ints


def shard_result(spec: RobotSpec, contract: Contract, robots: int, saved: Mapping[str, Any]) -> ShardResult:
    """Return the results of a saved shard, of its first `robots` robots."""
    judge = make_judge(spec, contract, WIDTH, counted=robots)
    judge.restore(inside(saved, "judge"))
    responses = saved_responses(inside(saved, "responses"), robots)
    return ShardResult(counts=judge.counts(), responses=responses, **samples(saved))


def samples(saved: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sampled arrays of a saved shard by name; empty for a snapshot."""
    return {name: saved[f"sampled.{name}"] for name in SAMPLED if f"sampled.{name}" in saved}
