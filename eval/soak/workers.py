"""Worker processes: every shard is lived to its end, whatever becomes of a worker."""

import multiprocessing as mp
import os
import signal
from collections.abc import Collection, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from deploy.operation.interrupts import handled
from eval.replay.event_capture import EVENTS, Witness
from eval.soak.checkpoint import Checkpoint, make
from eval.soak.configuration import Soak
from eval.soak.shard import Shard, ShardJob, ShardResult, shard_result
from robots.errors import OutputError

DEATHS = 3
"""Times in a row that a worker may die before anything new was done."""

# Of the worker process: set once, before its first shard. Without locks, which a worker that is killed would keep.
_progress: Any
_stop: Any


def _prepare(progress: Any, stop: Any) -> None:
    """Keep what the worker shares with its parent."""
    global _progress, _stop
    _progress, _stop = progress, stop


def _run(number: int, job: ShardJob, checkpoint: Checkpoint, events: Path) -> None:
    """One shard in a worker, from where it was kept; nothing if the soak was interrupted before anything of it was.

    What it lived through is handed over on disk: a worker that is killed while it talks would leave its parent waiting.
    """
    kept = checkpoint.load()
    if kept is None and _stop.value:
        return
    shard = Shard(job)
    if kept is not None:
        shard.restore(kept)

    def report(ticks: int) -> None:
        _progress[number] = ticks

    def keep() -> None:
        witness.begin(shard)
        checkpoint.store(shard.save())

    witness = Witness(job, shard, events)
    shard.run(report, lambda: bool(_stop.value), keep, witness.watch)


def take_up(soak: Soak, folder: Path, console: Console) -> int:
    """Control ticks, summed over shards, that an earlier start of the same soak left in `folder`.

    Raises:
        ConfigError: what is there is of another soak.
        OutputError: something damaged is there and cannot be set aside.
    """
    ticks = 0
    for number in range(len(soak.jobs())):
        checkpoint = soak.checkpoint(number, folder)
        there, kept = os.path.exists(checkpoint.path), checkpoint.load()
        if kept is not None:
            ticks += int(kept["runtime.ticks"])
        elif there:
            console.print(f"{checkpoint.path}: damaged and set aside: its robots begin anew", soft_wrap=True)
    return ticks


def run_soak(soak: Soak, folder: Path, console: Console) -> list[ShardResult]:
    """Run every shard and return their results in order; after Ctrl-C, what there is of them.

    Args:
        soak: what was asked for.
        folder: where shards are kept while they live, and taken up from; in it, the bundles of their events.
        console: told how far it is.

    Raises:
        ConfigError, OutputError: a shard cannot be taken up or kept.
        BrokenProcessPool: workers die again and again.
    """
    make(folder)
    crew, furthest, deaths = _Crew(soak, folder, console), -1, 0
    while crew.pending and not crew.stop.value:
        try:
            crew.work()
        except BrokenProcessPool:
            done = sum(crew.progress)
            furthest, deaths = max(furthest, done), 0 if done > furthest else deaths + 1
            if deaths == DEATHS:
                raise
            console.print("a worker died: its shards go on from where they were kept")
    return list(_results(soak, folder, crew.pending))


def _results(soak: Soak, folder: Path, pending: Collection[int]) -> Iterator[ShardResult]:
    for number, job in enumerate(soak.jobs()):
        checkpoint = soak.checkpoint(number, folder)
        kept = checkpoint.load()
        if kept is None:
            if number in pending:
                return  # robots have the numbers of their places: none is reported behind a gap
            raise OutputError(f"{checkpoint.path}: lost: it was whole when its robots had lived their hours")
        yield shard_result(soak.spec, soak.policy.contract, job.robots, kept)


class _Crew:
    """Shards that are done, and those that are not.

    Attributes:
        progress: ticks done of each shard. stop: not 0 once all are to end. pending: numbers of those not done.
    """

    def __init__(self, soak: Soak, folder: Path, console: Console) -> None:
        self._events = folder / EVENTS
        self._jobs, self._context = soak.jobs(), mp.get_context("spawn")
        self._checkpoints = [soak.checkpoint(number, folder) for number in range(len(self._jobs))]
        self._workers, self._ticks, self._console = soak.workers, soak.ticks, console
        self.progress = self._context.RawArray("q", len(self._jobs))
        self.stop = self._context.RawValue("b", 0)
        self.pending = set(range(len(self._jobs)))

    def work(self) -> None:
        """Run what is pending until it is done, interrupted, or a worker dies."""
        workers, shared = min(self._workers, len(self.pending)), (self.progress, self.stop)
        with ProcessPoolExecutor(workers, self._context, initializer=_prepare, initargs=shared) as pool:
            with handled(signal.SIG_IGN):  # which the workers inherit: only their parent hears Ctrl-C
                futures = {
                    pool.submit(
                        _run, number, self._jobs[number], self._checkpoints[number], self._events
                    ): number
                    for number in sorted(self.pending)
                }
            try:
                with handled(_interrupt):
                    self._watch(futures)
            except KeyboardInterrupt:
                self.stop.value = 1
                self._console.print("interrupted: the report will hold what was done so far")
                with handled(signal.SIG_IGN):
                    for future in futures:
                        future.result()
            except BrokenProcessPool:
                raise
            except BaseException:
                self.stop.value = 1
                raise

    def _watch(self, futures: "Mapping[Future[None], int]") -> None:
        """Show progress until every shard is done or one has failed."""
        columns = (
            TextColumn("soaking"),
            BarColumn(),
            TextColumn("{task.percentage:5.1f} %"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=True),
        )
        with Progress(*columns, console=self._console) as bar:
            task, waiting = bar.add_task("", total=self._ticks * len(self._jobs)), set(futures)
            while waiting:
                done, waiting = wait(waiting, timeout=0.5)
                bar.update(task, completed=sum(self.progress))
                for future in done:
                    future.result()
                    self.pending.discard(futures[future])


def _interrupt(_signal: int, _frame: object) -> None:
    raise KeyboardInterrupt
