"""From what shards lived through to what the report is built from."""

import sys
from collections.abc import Sequence
from functools import reduce
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eval.asked import Soak
from eval.counts import merge
from eval.identity import code_digest, versions
from eval.report.data import Run, Settings, SoakResult
from eval.shard import WIDTH, ShardResult
from robots.distributions import load_distributions

GOAL_BINS = 8
UNSEEN = (
    "Links, gears and ground are rigid: nothing bends, rings, shakes or grows with its warmth.",
    "Friction depends on neither load nor warmth, and motors turn without cogging or ripple. Iron losses only warm:"
    " what they brake is taken as part of the joint's damping.",
    "Joints wear with the way they go and with warmth, and nothing breaks; brakes, cable, windings and links stay new.",
    "No sensor fails: readings are noisy, coarse, biased and drifting, packets late and lost, but no fault was"
    " scheduled. Nothing interferes with cables, and no encoder's error depends on the angle.",
    "Drives are ideal: current follows at once, and their software has no limits, filters or faults of its own."
    " Commands reach a drive late, always by the same time, and are never lost.",
    "The supply sags and never fails. Brakes are drives that hold. Currents are looked at once a control tick, by the"
    " simulated windings as by the observer that guards them: what lies between warms neither.",
    "A payload appears at the tool and vanishes, a push is a force on one link, the cable a spring without weight:"
    " nothing is gripped, nobody is clamped, and there is nothing to bump into but the robot and its model's scene.",
    "The computer keeps every period: simulated time waits for it.",
    "An operator comes a minute after a robot latched and arms it again, without looking for the cause.",
    "The report counts what the simulation can show; a real robot has been nowhere in it.",
)


def collect(soak: Soak, shards: Sequence[ShardResult], run: Run) -> SoakResult:
    """Put shards side by side.

    Heat and wear that an interrupted shard did not reach are NaN; its goals stay as they stood.
    """
    samples = max(len(shard.attempted) for shard in shards) - 1
    per_bin, sample_h = max(1, -(-samples // GOAL_BINS)), soak.sample_ticks * soak.spec.dt / 3600
    return SoakResult(
        settings=_settings(soak),
        run=run,
        counts=reduce(merge, (shard.counts for shard in shards)),
        sample_h=sample_h * np.arange(samples + 1, dtype=np.float64),
        winding_c=_side_by_side([shard.winding_c for shard in shards]),
        worn=_side_by_side([shard.worn for shard in shards]),
        winding_soft_c=soak.spec.motor_array("winding_soft_c"),
        winding_max_c=soak.spec.motor_array("winding_max_c"),
        goals_bin_h=per_bin * sample_h,
        goals_attempted=_binned([shard.attempted for shard in shards], per_bin),
        goals_reached=_binned([shard.reached for shard in shards], per_bin),
        unseen=UNSEEN,
    )


def _side_by_side(parts: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """(T, ..., R, n) of shards, the shorter ones filled up with NaN, to one of all robots."""
    most = max(map(len, parts))
    filled = [
        np.pad(p, ((0, most - len(p)), *((0, 0),) * (p.ndim - 1)), constant_values=np.nan) for p in parts
    ]
    return np.concatenate(filled, axis=-2)


def _binned(totals: Sequence[NDArray[np.int64]], per_bin: int) -> NDArray[np.int64]:
    """Running totals of shards, from 0 on, to what came in each bin; the last bin may be shorter."""
    samples = max(map(len, totals)) - 1
    total = sum(np.pad(t, (0, samples + 1 - len(t)), "edge") for t in totals)
    return np.diff(np.asarray(total)[[*range(0, samples, per_bin), samples]])


def _settings(soak: Soak) -> Settings:
    return Settings(
        command=" ".join(["soak-test", *sys.argv[1:]]),
        robot=soak.spec.name,
        robot_digest=soak.spec.digest,
        draws_digest=load_distributions(soak.spec).digest,
        policy=_shown(soak.policy_path),
        policy_digest=soak.policy.digest,
        code_digest=code_digest(),
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
