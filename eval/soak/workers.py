"""Worker processes that run all shards to their end, also if a worker dies, and end with their parent."""

import multiprocessing as mp
import os
import signal
from collections.abc import Collection, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from deploy.operation.interrupts import handled
from eval.replay.event_capture import EVENTS, EventCapture
from eval.shard.job import ShardJob
from eval.shard.judging import ShardResult, shard_result
from eval.shard.shard import Shard
from eval.soak.checkpoint import Checkpoint, prepare_folder
from eval.soak.configuration import SoakConfig
from robots.child_process import Lifeline, end_with
from robots.errors import OutputError

DEATHS = 3
"""Deaths of workers in a row, without any progress between them, that end the soak."""
COLUMNS = (
    TextColumn("soaking"),
    BarColumn(),
    TextColumn("{task.percentage:5.1f} %"),
    TimeElapsedColumn(),
    TextColumn("left"),
    TimeRemainingColumn(elapsed_when_finished=True),
)

# Shared with the parent process and set before the first shard. No locks: a killed worker would never release them.
_progress: Any
_stop: Any


def _initialize_worker(lifeline: Connection, progress: Any, stop: Any) -> None:
    global _progress, _stop
    end_with(lifeline)
    _progress, _stop = progress, stop


def _run_shard(number: int, job: ShardJob, checkpoint: Checkpoint, events: Path) -> None:
    """Run one shard in a worker from its checkpoint; do nothing if the soak was stopped before the shard began.

    Results are passed on disk: a worker that is killed while it sends data would block its parent.
    """
    saved = checkpoint.load()
    if saved is None and _stop.value:
        return
    shard = Shard(job)
    if saved is not None:
        shard.restore(saved)

    def report(ticks: int) -> None:
        _progress[number] = ticks

    def store() -> None:
        capture.flush(shard)
        checkpoint.store(shard.save())

    capture = EventCapture(job, shard, events)
    shard.run(report, lambda: bool(_stop.value), store, capture.observe)


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
        BrokenProcessPool: workers died several times in a row.
    """
    prepare_folder(folder)
    pool, furthest, deaths = WorkerPool(config, folder, console), -1, 0
    while pool.pending and not pool.stop.value:
        try:
            pool.run()
        except BrokenProcessPool:
            done = sum(pool.progress)
            furthest, deaths = max(furthest, done), 0 if done > furthest else deaths + 1
            if deaths == DEATHS:
                raise
            console.print("a worker died: its shards resume from their checkpoints")
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


class WorkerPool:
    """Worker processes and the shards that they have to run.

    Attributes:
        progress: ticks done of each shard. stop: not 0 once all shards are to end. pending: shards not finished.
    """

    def __init__(self, config: SoakConfig, folder: Path, console: Console) -> None:
        self._config, self._events, self._console = config, folder / EVENTS, console
        self._jobs, self._context = config.jobs(), mp.get_context("spawn")
        self._checkpoints = [config.checkpoint(number, folder) for number in range(len(self._jobs))]
        self.progress = self._context.RawArray("q", len(self._jobs))
        self.stop = self._context.RawValue("b", 0)
        self.pending = set(range(len(self._jobs)))

    def run(self) -> None:
        """Run the pending shards until all are finished, the user interrupts, or a worker dies.

        The others then end with it: they may wait for a lock that it held, and ignore the pool's SIGTERM.
        """
        workers = min(self._config.workers, len(self.pending))
        with Lifeline() as lifeline:
            shared = lifeline.end, self.progress, self.stop
            with ProcessPoolExecutor(workers, self._context, _initialize_worker, shared) as pool:
                try:
                    self._run_until_interrupted(pool)
                except BrokenProcessPool:
                    lifeline.cut()
                    raise
                except BaseException:
                    self.stop.value = 1
                    raise

    def _run_until_interrupted(self, pool: ProcessPoolExecutor) -> None:
        """Run the pending shards; after Ctrl-C, wait until those that run have stored their checkpoints."""
        futures = self._submit(pool)
        try:
            with handled(_interrupt):
                self.show_progress(futures)
        except KeyboardInterrupt:
            self.stop.value = 1
            self._console.print("interrupted: the report will cover what has run so far")
            with handled(signal.SIG_IGN):
                for future in futures:
                    future.result()

    def _submit(self, pool: ProcessPoolExecutor) -> "dict[Future[None], int]":
        futures = {}
        with handled(signal.SIG_IGN):  # inherited by the workers: only the parent handles Ctrl-C
            for number in sorted(self.pending):
                inputs = self._jobs[number], self._checkpoints[number], self._events
                futures[pool.submit(_run_shard, number, *inputs)] = number
        return futures

    def show_progress(self, futures: "Mapping[Future[None], int]") -> None:
        """Show progress until every shard is finished or one has failed."""
        with Progress(*COLUMNS, console=self._console) as bar:
            task, waiting = bar.add_task("", total=self._config.ticks * len(self._jobs)), set(futures)
            while waiting:
                done, waiting = wait(waiting, timeout=0.5)
                bar.update(task, completed=sum(self.progress))
                for future in done:
                    future.result()
                    self.pending.discard(futures[future])


def _interrupt(_signal: int, _frame: object) -> None:
    raise KeyboardInterrupt
