"""Worker processes, one for each shard, several at a time; one that dies is replaced, and all end with their parent."""

import multiprocessing as mp
import signal
import time
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from deploy.operation.interrupts import handled, interrupt, starting_workers
from eval.replay.event_capture import EVENTS
from eval.soak.configuration import SoakConfig
from eval.soak.worker import Task, work
from robots.child_process import Lifeline, check_not_crowded
from robots.errors import FirstshiftError

DEATHS = 4
"""Deaths of a shard's workers in a row, without any progress between them, that end the soak."""
POLL_S = 0.5
END_S = 60.0
"""s that workers get to store their checkpoints and end; those that do not, as one that SIGSTOP stopped, are killed."""
COLUMNS = (
    TextColumn("soaking"),
    BarColumn(),
    TextColumn("{task.percentage:5.1f} %"),
    TimeElapsedColumn(),
    TextColumn("left"),
    TimeRemainingColumn(),
)


class Worker(NamedTuple):
    """A running worker, and the end of the pipe on which it sends an error."""

    number: int
    process: BaseProcess
    errors: Connection


class WorkerPool:
    """Workers, and the shards that they have to run.

    The pools of the standard library are not used: their workers share locks, which one that is killed may hold, and a
    pool of Python 3.11 overlooks the death of the worker that it started last.

    Attributes:
        progress: ticks done of each shard. stop: not 0 once all shards are to end. pending: shards not finished.
    """

    def __init__(self, config: SoakConfig, folder: Path, console: Console) -> None:
        self._config, self._console, self._context = config, console, mp.get_context("spawn")
        jobs = config.jobs()
        self.progress, self.stop = self._context.RawArray("q", len(jobs)), self._context.RawValue("b", 0)
        self.pending = set(range(len(jobs)))
        self._tasks = [
            Task(
                number=number,
                job=job,
                checkpoint=config.checkpoint(number, folder),
                events=folder / EVENTS,
                progress=self.progress,
                stop=self.stop,
            )
            for number, job in enumerate(jobs)
        ]
        self._running: dict[int, Worker] = {}
        self._furthest, self._deaths = [-1] * len(jobs), [0] * len(jobs)

    def run(self) -> None:
        """Run the pending shards until all are finished, or the user interrupts.

        Raises:
            FirstshiftError: of a worker.
            OSError: the computer lacks a process or a thread for one.
            RuntimeError: a worker failed, or workers of a shard died several times in a row.
        """
        with Lifeline() as self._lifeline:
            try:
                self._run_until_interrupted()
            except BaseException:
                self.stop.value = 1
                self._join_all()
                raise

    def _run_until_interrupted(self) -> None:
        """Run the pending shards; after Ctrl-C, wait until those that run have stored their checkpoints."""
        try:
            with handled(interrupt), Progress(*COLUMNS, console=self._console) as bar:
                shown = bar.add_task("", total=self._config.ticks * len(self._tasks))
                while self.pending:
                    self.step()
                    bar.update(shown, completed=sum(self.progress))
        except KeyboardInterrupt:
            self.stop.value = 1
            self._console.print("interrupted: the report will cover what has run so far")
            with handled(signal.SIG_IGN):
                self._join_all()
                while self._running:
                    self._collect(None)

    def _join_all(self) -> None:
        """Wait until all workers have ended, and kill those that do not."""
        ended = time.monotonic() + END_S
        for worker in self._running.values():
            worker.process.join(max(0.0, ended - time.monotonic()))
            if worker.process.is_alive():
                self._console.print(f"the worker of shard {worker.number} did not end in {END_S:g} s: killed")
                worker.process.kill()
                worker.process.join()

    def step(self) -> None:
        """Start workers while there is room, and wait a moment for some to end."""
        started = {worker.number for worker in self._running.values()}
        for number in sorted(self.pending - started)[: self._config.workers - len(started)]:
            self._start(number)
        self._collect(POLL_S)

    def _start(self, number: int) -> None:
        errors, sender = self._context.Pipe(duplex=False)
        process = self._context.Process(target=work, args=(self._lifeline.end, sender, self._tasks[number]))
        with starting_workers():
            process.start()
            sender.close()
            self._running[process.sentinel] = Worker(number, process, errors)

    def _collect(self, seconds: float | None) -> None:
        ended = wait(list(self._running), seconds)
        for sentinel in [each for each in self._running if each in ended]:
            self._end(self._running.pop(sentinel))

    def _end(self, worker: Worker) -> None:
        """Judge a worker that has ended."""
        worker.process.join()
        code, error = worker.process.exitcode or 0, _received(worker.errors)
        if error is not None:
            raise error
        check_not_crowded(code)
        if code > 0:
            raise RuntimeError(f"the worker of shard {worker.number} failed, with exit code {code}")
        if self.stop.value:
            return
        if code < 0:
            self._count_death(worker.number)
        else:
            self.pending.discard(worker.number)

    def _count_death(self, number: int) -> None:
        """Note that a worker was killed; its shard is still pending."""
        done = self.progress[number]
        self._deaths[number] = 1 if done > self._furthest[number] else self._deaths[number] + 1
        self._furthest[number] = max(self._furthest[number], done)
        if self._deaths[number] == DEATHS:
            raise RuntimeError(f"workers of shard {number} died {DEATHS} times in a row")
        self._console.print("a worker died: its shard resumes from its checkpoint")


def _received(errors: Connection) -> FirstshiftError | None:
    """Return the error that a worker has sent, and close the pipe."""
    with errors:
        try:
            error: FirstshiftError = errors.recv()
        except (EOFError, OSError):  # nothing was sent, or not all of it
            return None
    return error
