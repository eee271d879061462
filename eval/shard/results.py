"""Results of a shard: judge's counts, fault responses, and samples over time."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from deploy.policy.contract import Contract
from deploy.stage import inside
from eval.faults.fault_response import FaultResponses, saved_responses
from eval.judge.counts import Counts
from eval.shard.judging import judge_of
from robots.arrays import Floats, Ints
from robots.spec import RobotSpec

COUNTED = ("attempted", "reached", "running", "stops", "latches")
"""Running totals of `Counts` that are sampled."""
SAMPLED = ("winding_c", "worn", "folded_back", *COUNTED, "events")


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardResult:
    """Results of the R robots that count; samples are taken at the start and then at a fixed interval.

    Attributes:
        counts: from the judge.
        responses: to injected faults.
        winding_c: (T, R, n) °C, true winding temperature; NaN where the simulation diverged, as in the next two.
        worn: (T, 4, R, n) wear of the joints, in the order of `Worn`.
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
    """Return the results of a saved shard.

    Args:
        spec: the robot. contract: the policy's. robots: number of robots that count.
        saved: from `Shard.save`.
    """
    judge = judge_of(spec, contract, robots)
    judge.restore(inside(saved, "judge"))
    responses = saved_responses(inside(saved, "responses"), robots)
    return ShardResult(counts=judge.counts(), responses=responses, **samples(saved))


def samples(saved: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sampled arrays of a saved shard by name; empty for a snapshot."""
    return {name: saved[f"sampled.{name}"] for name in SAMPLED if f"sampled.{name}" in saved}
