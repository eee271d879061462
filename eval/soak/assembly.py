"""Assembly of the shards' results into the input of the report."""

from collections.abc import Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.policy.compatibility import sensors_read
from eval.faults.fault_response import merge_responses
from eval.history.soak_record import Run
from eval.judge.counts import merge
from eval.report.sections.faults import fault_table
from eval.report.soak_result import SoakResult
from eval.shard.judging import ShardResult
from eval.soak.configuration import SoakConfig
from eval.statistics.sensitivity import parameter_values

GOAL_BINS = 8
SAMPLES, TOTALS = ("winding_c", "folded_back", "worn"), ("stops", "latches")


def assemble(
    config: SoakConfig, shards: Sequence[ShardResult], run: Run, bundles: Sequence[str] = ()
) -> SoakResult:
    """Concatenate the robots of all shards.

    Heat and wear are NaN after the end of an interrupted shard; its goals and stops keep their last values. If not all
    shards began, `shards` are the first ones. `bundles` are relative to the report's folder.
    """
    counts = reduce(merge, (shard.counts for shard in shards))
    drawn = parameter_values(config.draw_robots(), config.distributions)
    samples = max(len(shard.attempted) for shard in shards) - 1
    read = sensors_read(config.policy.contract, config.spec)
    responses = merge_responses([shard.responses for shard in shards])
    per_bin, sample_h = max(1, -(-samples // GOAL_BINS)), config.sample_ticks * config.spec.dt / 3600
    arrays: dict[str, Any] = {
        **{name: pad_and_join([getattr(shard, name) for shard in shards]) for name in SAMPLES},
        **{name: _join_totals([getattr(shard, name) for shard in shards]) for name in TOTALS},
    }
    return SoakResult(
        settings=config.settings(),
        run=run,
        counts=counts,
        sample_h=sample_h * np.arange(samples + 1, dtype=np.float64),
        **arrays,
        goals_bin_h=per_bin * sample_h,
        goals_attempted=_binned([shard.attempted for shard in shards], per_bin),
        goals_reached=_binned([shard.reached for shard in shards], per_bin),
        parameters={name: column[: counts.robots] for name, column in drawn.items()},
        bundles=tuple(bundles),
        faults=None if config.faults is None else fault_table(config.spec, read, config.faults, responses),
    )


def _padded(parts: Sequence[NDArray[Any]], **how: Any) -> list[NDArray[Any]]:
    longest = max(map(len, parts))
    return [np.pad(p, ((0, longest - len(p)), *((0, 0),) * (p.ndim - 1)), **how) for p in parts]


def pad_and_join(parts: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Join (T, ..., R, n) of shards along the robots; shorter ones are padded with NaN."""
    return np.concatenate(_padded(parts, constant_values=np.nan), axis=-2)


def _join_totals(parts: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Join running totals (T, R, ...) of shards along the robots; shorter ones keep their last values."""
    return np.concatenate(_padded(parts, mode="edge"), axis=1)


def running_total(parts: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return the sums (T, ...) over all robots of running totals (T, R, ...) of shards."""
    return np.asarray(_join_totals(parts).sum(axis=1))


def _binned(parts: Sequence[NDArray[np.int64]], per_bin: int) -> NDArray[np.int64]:
    """Increase of running totals (T, R) within each bin, all robots together; the last bin may be shorter."""
    total = running_total(parts)
    samples = len(total) - 1
    return np.diff(total[[*range(0, samples, per_bin), samples]])
