"""All shards of a soak, run to their end from the checkpoints of an earlier start."""

import os
from collections.abc import Collection, Iterator
from pathlib import Path

from rich.console import Console

from eval.shard.judging import ShardResult, shard_result
from eval.soak.checkpoint import prepare_folder
from eval.soak.configuration import SoakConfig
from eval.soak.worker_pool import WorkerPool
from robots.errors import OutputError


def resumed_ticks(config: SoakConfig, folder: Path, console: Console) -> int:
    """Return the control ticks, summed over shards, in the checkpoints of an earlier start in `folder`.

    Raises:
        ConfigError: a checkpoint is of another soak.
        OutputError: a damaged checkpoint cannot be renamed.
    """
    ticks = 0
    for number in range(len(config.jobs())):
        checkpoint = config.checkpoint(number, folder)
        exists, saved = os.path.exists(checkpoint.path), checkpoint.load()
        if saved is not None:
            ticks += int(saved["runtime.ticks"])
        elif exists:
            console.print(f"{checkpoint.path}: damaged and renamed: its robots start again", soft_wrap=True)
    return ticks


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
        yield shard_result(config.spec, config.policy.contract, job.robots, saved)
