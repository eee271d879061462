"""All shards of a soak, run to their end from the checkpoints of an earlier start."""

import os
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
from rich.console import Console

from deploy.stage import Arrays
from eval.shard.job import WIDTH, ShardJob
from eval.shard.judging import ShardResult, shard_result
from eval.shard.shard import Shard
from eval.soak.checkpoint import prepare_folder
from eval.soak.configuration import SoakConfig
from eval.soak.worker_pool import WorkerPool
from robots.errors import OutputError, printable

SIZE_MAX = 1e100
"""Upper bound of a finite number of a checkpoint: above all that float32, in which policies compute, can hold."""
SHARES = ("sampled.folded_back", "runtime.estimator.windings.foldback.current_share")
"""Arrays of a checkpoint with shares that are reported."""


def resumed_ticks(config: SoakConfig, folder: Path, console: Console) -> int:
    """Return the control ticks, summed over shards, in the checkpoints of an earlier start in `folder`.

    Raises:
        ConfigError: a checkpoint is of another soak.
        OutputError: a damaged checkpoint cannot be renamed.
    """
    ticks = 0
    for number, job in enumerate(config.jobs()):
        checkpoint = config.checkpoint(number, folder)
        exists, saved = os.path.exists(checkpoint.path), checkpoint.load()
        if saved is not None and not _fits(saved, job):
            checkpoint.set_aside()
            saved = None
        if saved is not None:
            ticks += int(saved["runtime.ticks"])
        elif exists:
            path = printable(str(checkpoint.path))
            console.print(f"{path}: damaged and renamed: its robots start again", soft_wrap=True)
    return ticks


def _fits(saved: Arrays, job: ShardJob) -> bool:
    """Return whether arrays are those of a shard of the job, as far as names, shapes, dtypes and a first tick tell."""
    ticks = saved.get("runtime.ticks", np.array(None))
    if ticks.shape or ticks.dtype.kind != "i" or not 0 <= int(ticks) <= job.ticks:
        return False
    shard = Shard(job)
    for _ in range(int(ticks) // job.sample_ticks + 1):
        shard.sample()
    fresh = shard.save()
    likely = _kinds(saved) == _kinds(fresh) and _are_within_bounds(saved) and _are_counts(saved, fresh, shard)
    return likely and _goes_on(shard, job, saved)


def _are_within_bounds(saved: Arrays) -> bool:
    """Return whether no finite number is beyond `SIZE_MAX`, and no share below 0 or above 1; NaN is unknown."""
    floats = [array for array in saved.values() if array.dtype == np.float64]
    too_large = any((np.isfinite(array) & (np.abs(array) > SIZE_MAX)).any() for array in floats)
    shares = [np.asarray(saved[name], dtype=np.float64) for name in SHARES]
    return not too_large and not any(((share < 0) | (share > 1)).any() for share in shares)


def _are_counts(saved: Arrays, fresh: Arrays, shard: Shard) -> bool:
    """Return whether no count is below that of a `fresh` shard, or above ticks of all joints and rows of the log."""
    most = int(saved["runtime.ticks"]) * WIDTH * shard.runtime.spec.n + len(shard.judge.events.start)
    counts = [
        (array, fresh[name])
        for name, array in saved.items()
        if name.startswith(("judge.", "sampled.")) and not name.startswith("judge.buffer.")
        if array.dtype.kind == "i" and array.size
    ]
    return all(start.min() <= array.min() and array.max() <= most for array, start in counts)


def _goes_on(shard: Shard, job: ShardJob, saved: Arrays) -> bool:
    """Return whether a shard can be restored, simulate a tick and have results: wrong indices would end it."""
    try:
        shard.restore(saved)
        shard.tick()
        shard_result(shard.runtime.spec, shard.runtime.contract, job.robots, shard.save())
    except (IndexError, OverflowError, ValueError):
        return False
    return True


def _kinds(arrays: Arrays) -> dict[str, tuple[object, ...]]:
    return {name: (array.shape, array.dtype) for name, array in arrays.items()}


def run_soak(config: SoakConfig, folder: Path, console: Console) -> list[ShardResult]:
    """Run every shard and return the results in order; after Ctrl-C, of the shards that have begun.

    `folder` gets the checkpoints, from which shards resume, and the bundles of events.

    Raises:
        ConfigError, OutputError: a checkpoint cannot be read or written.
        RuntimeError: a worker failed, or workers died several times in a row.
    """
    prepare_folder(folder)
    pool = WorkerPool(config, folder, console)
    pool.run()
    return list(_results(config, folder, pool.pending))


def _results(config: SoakConfig, folder: Path, pending: Collection[int]) -> Iterator[ShardResult]:
    for number, job in enumerate(config.jobs()):
        checkpoint = config.checkpoint(number, folder)
        saved = checkpoint.load()
        if saved is None:
            if number in pending:
                return  # robots are numbered by position, so that none is reported after a missing shard
            raise OutputError(f"{checkpoint.path}: lost after its shard was finished")
        if not _fits(saved, job) or (number not in pending and int(saved["runtime.ticks"]) < job.ticks):
            raise OutputError(f"{checkpoint.path}: replaced while the soak ran")
        yield shard_result(config.spec, config.policy.contract, job.robots, saved)
