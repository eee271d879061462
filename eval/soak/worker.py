"""Worker process of a soak: runs one shard, from its checkpoint if there is one."""

from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from deploy.operation.interrupts import ignore_signals
from eval.replay.event_capture import EventCapture
from eval.shard.job import ShardJob
from eval.shard.shard import Shard
from eval.soak.checkpoint import Checkpoint
from robots.child_process import end_with
from robots.errors import FirstshiftError


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One worker's task.

    Attributes:
        number: of the shard. events: folder of bundles.
        progress: ticks done of each shard, and stop: not 0 once all shards are to end. Both are shared with the parent,
            without locks: a killed worker would never release them.
    """

    number: int
    job: ShardJob
    checkpoint: Checkpoint
    events: Path
    progress: Any
    stop: Any


def work(lifeline: Connection, errors: Connection, task: Task) -> None:
    """Run a shard and send the parent an error that a user can correct; any other ends this process.

    Results are passed on disk: a worker that is killed while it sends data would block its parent.
    """
    ignore_signals()
    end_with(lifeline)
    try:
        _run_shard(task)
    except FirstshiftError as e:
        errors.send(e)


def _run_shard(task: Task) -> None:
    """Do nothing if the soak was stopped before the shard began."""
    saved = task.checkpoint.load()
    if saved is None and task.stop.value:
        return
    shard = Shard(task.job)
    if saved is not None:
        shard.restore(saved)

    def report(ticks: int) -> None:
        task.progress[task.number] = ticks

    def store() -> None:
        capture.flush(shard)
        task.checkpoint.store(shard.save())

    capture = EventCapture(task.job, shard, task.events)
    shard.run(report, lambda: bool(task.stop.value), store, capture.observe)
