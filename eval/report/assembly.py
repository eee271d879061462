"""From what shards lived through to what the report is built from."""

import sys
from collections.abc import Sequence
from functools import reduce
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eval.faults.fault_response import merge_responses
from eval.history.night_record import Run, Settings
from eval.judge.counts import merge
from eval.judge.limits import load_limits
from eval.report.schema.report_data import SoakResult
from eval.report.sections.faults import fault_table
from eval.soak.configuration import Soak
from eval.soak.fingerprint import code_digest, versions
from eval.soak.shard import WIDTH, ShardResult
from eval.statistics.sensitivity import parameters
from robots.distributions import load_distributions

GOAL_BINS = 8
UNSEEN = (
    "Links, gears and ground are rigid: nothing bends, rings, shakes or grows with its warmth.",
    "Friction depends on neither load nor warmth, and motors turn without cogging or ripple. Iron losses only warm:"
    " what they brake is taken as part of the joint's damping.",
    "Joints wear with the way they go and with warmth, and nothing breaks; brakes, cable, windings and links stay new.",
    "Nothing interferes with the cables of sensors, and no encoder's error depends on the angle.",
    "Drives are ideal: current follows at once, and their software has no limits, filters or faults of its own."
    " Commands reach a drive late, always by the same time, and are never lost.",
    "The supply sags and never fails. Brakes are drives that hold. Currents are looked at once a control tick, by the"
    " simulated windings as by the observer that guards them: what lies between warms neither.",
    "A payload appears at the tool and vanishes, a push is a force on one link, the cable a spring without weight:"
    " nothing is gripped, nobody is clamped, and there is nothing to bump into but the robot and its model's scene.",
    "The computer keeps every period: simulated time waits for it.",
    "An operator comes a while after a robot latched and arms it again, without looking for the cause.",
    "The report counts what the simulation can show; a real robot has been nowhere in it.",
)
NO_FAULTS = (
    "No sensor fails: readings are noisy, coarse, biased and drifting, packets late and lost, but no fault was"
    " scheduled, of sensors or of anything else."
)
FAULTS = (
    "Faults were injected on schedule, at a rate that no robot at work would see: rates, availability and goals of this"
    " run are those of robots that are being broken."
)


def collect(soak: Soak, shards: Sequence[ShardResult], run: Run, bundles: Sequence[str] = ()) -> SoakResult:
    """Put shards side by side.

    Heat and wear that an interrupted shard did not reach are NaN; its goals and stops stay as they stood.

    Args:
        soak: what was asked for. shards: in order, the first ones if not all began. run: how it went.
        bundles: folders of events, as seen from the report's.
    """
    counts = reduce(merge, (shard.counts for shard in shards))
    drawn = parameters(soak.drawn(), load_distributions(soak.spec))
    samples = max(len(shard.attempted) for shard in shards) - 1
    found = merge_responses([shard.injections for shard in shards])
    per_bin, sample_h = max(1, -(-samples // GOAL_BINS)), soak.sample_ticks * soak.spec.dt / 3600
    return SoakResult(
        settings=settings(soak),
        run=run,
        counts=counts,
        sample_h=sample_h * np.arange(samples + 1, dtype=np.float64),
        winding_c=side_by_side([shard.winding_c for shard in shards]),
        folded_back=side_by_side([shard.folded_back for shard in shards]),
        worn=side_by_side([shard.worn for shard in shards]),
        winding_soft_c=soak.spec.motor_array("winding_soft_c"),
        winding_max_c=soak.spec.motor_array("winding_max_c"),
        stops=_held([shard.stops for shard in shards]),
        latches=_held([shard.latches for shard in shards]),
        goals_bin_h=per_bin * sample_h,
        goals_attempted=_binned([shard.attempted for shard in shards], per_bin),
        goals_reached=_binned([shard.reached for shard in shards], per_bin),
        parameters={name: column[: counts.robots] for name, column in drawn.items()},
        bundles=tuple(bundles),
        unseen=(NO_FAULTS if soak.faults is None else FAULTS, *UNSEEN),
        faults=None if soak.faults is None else fault_table(soak.spec, soak.faults, found),
    )


def side_by_side(parts: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """(T, ..., R, n) of shards, the shorter ones filled up with NaN, to one of all robots."""
    most = max(map(len, parts))
    filled = [
        np.pad(p, ((0, most - len(p)), *((0, 0),) * (p.ndim - 1)), constant_values=np.nan) for p in parts
    ]
    return np.concatenate(filled, axis=-2)


def _held(parts: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Running totals (T, R, ...) of shards to those of all robots; those of the shorter ones stay as they stood."""
    most = max(map(len, parts))
    held = [np.pad(p, ((0, most - len(p)), *((0, 0),) * (p.ndim - 1)), "edge") for p in parts]
    return np.concatenate(held, axis=1)


def running_total(parts: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """(T, ...) of all robots together, from running totals (T, R, ...) of shards."""
    return np.asarray(_held(parts).sum(axis=1))


def _binned(parts: Sequence[NDArray[np.int64]], per_bin: int) -> NDArray[np.int64]:
    """Running totals (T, R) of shards, from 0 on, to what came in each bin; the last bin may be shorter."""
    total = running_total(parts)
    samples = len(total) - 1
    return np.diff(total[[*range(0, samples, per_bin), samples]])


def settings(soak: Soak) -> Settings:
    """What the soak was asked for, as its report says it."""
    return Settings(
        command=" ".join(["soak-test", *sys.argv[1:]]),
        robot=soak.spec.name,
        robot_digest=soak.spec.digest,
        draws_digest=load_distributions(soak.spec).digest,
        limits_digest=load_limits(soak.spec).digest,
        policy=_shown(soak.policy_path),
        policy_digest=soak.policy.digest,
        code_digest=code_digest(),
        faults=soak.faults,
        budget=_shown(soak.budget),
        seed=soak.seed,
        hours=soak.hours,
        robots=soak.robots,
        shard_width=WIDTH,
        workers=soak.workers,
        versions=versions(),
    )


def _shown(path: Path) -> str:
    """As a reader of the report knows it: from the folder the soak was started in, if it lies there."""
    here = Path.cwd()
    return str(path.resolve().relative_to(here) if path.resolve().is_relative_to(here) else path)
