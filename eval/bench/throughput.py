"""Throughput of a soak: time ÷ that of bare physics, gain from a second worker, best width of a shard."""

import gc
import multiprocessing as mp
import tempfile
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

from eval.bench.soak_setup import shard_job
from eval.bench.stages import StageBench
from eval.replay.event_capture import EventCapture
from eval.shard.job import WIDTH
from eval.shard.shard import Shard
from robots.arrays import Floats
from robots.child_process import Lifeline, end_with
from robots.spec import RobotSpec, load_robot

WORKERS = 2
WIDTHS = (8, 16, 32)
WARM_S, ROUND_S, ROUNDS = 10, 4, 9
"""s before the first round, s of a round (one goal), rounds: shard and physics in turns, all workers in step."""


def throughput(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Print the time of shards, as in a soak, against that of physics alone, alternately on the same cores."""
    one, two = (
        np.median(_measure(workers, _shard_worker, spec.folder, policy), axis=(0, 1))
        for workers in (1, WORKERS)
    )
    shard, physics = two
    console.print(
        f"{WORKERS} workers, shards of {WIDTH}: {shard / physics:.2f} times the time of bare physics for the same"
        f" steps (at most 1.6); {ROUND_S * WIDTH * WORKERS / shard:.0f} robot-seconds per second"
    )
    console.print(f"{WORKERS} workers do {WORKERS * one[0] / shard:.2f} times the work of one (at least 1.8)")
    _compare_widths(spec, policy, console)


def _measure(workers: int, target: Callable[..., None], *args: Any) -> Floats:
    """Return the times that each worker measured, all of them in step: (workers, ROUNDS, ...) s."""
    context = mp.get_context("spawn")
    barrier, pipes = context.Barrier(workers), [context.Pipe(duplex=False) for _ in range(workers)]
    with Lifeline() as lifeline:
        processes = [
            context.Process(target=_work, args=(lifeline.end, target, *args, number, barrier, sender))
            for number, (_, sender) in enumerate(pipes)
        ]
        for process in processes:
            process.start()
        times = np.array([receiver.recv() for receiver, _ in pipes])
        for process in processes:
            process.join()
    return times


def _work(lifeline: Connection, target: Callable[..., None], *args: Any) -> None:
    end_with(lifeline)
    target(*args)


def _shard_worker(folder: Path, policy: Path, number: int, barrier: Any, sender: Any) -> None:
    """Time a shard with its event capture, then the same steps of physics alone, in each round."""
    spec = load_robot(folder)
    job = shard_job(spec, policy, WARM_S + ROUND_S * ROUNDS, first=number * WIDTH)
    with tempfile.TemporaryDirectory() as events:
        shard = Shard(job)
        capture = EventCapture(job, shard, Path(events))

        def run(seconds: float) -> None:
            for _ in range(round(seconds / spec.dt)):
                shard.tick()
                capture.observe(shard)

        run(WARM_S)
        gc.collect()
        gc.freeze()
        physics = RolloutReplay(shard.robot.plant.batch)
        rounds = []
        for _ in range(ROUNDS):
            physics.record()
            rounds.append((_timed(lambda: run(ROUND_S), barrier), _timed(physics.replay, barrier)))
        sender.send(rounds)
        gc.unfreeze()


def _timed(work: Callable[[], None], barrier: Any) -> float:
    """Return s of work that all workers start together."""
    barrier.wait()
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


class RolloutReplay:
    """Recorder of a batch's rollouts, which can repeat them."""

    def __init__(self, batch: Batch) -> None:
        self._batch, self._rollout = batch, batch.rollout
        self._calls: list[tuple[tuple[Any, ...], dict[str, Any]]] = []
        batch.rollout = self._recorded

    def _recorded(self, *args: Any, **kwargs: Any) -> Any:
        self._calls.append((args, kwargs | {"control": kwargs["control"].copy()}))
        return self._rollout(*args, **kwargs)

    def record(self) -> None:
        """Start a new recording at the present state."""
        self._calls.clear()
        self._start = self._batch.state.copy()

    def replay(self) -> None:
        """Repeat all recorded rollouts from the state at the start of the recording."""
        self._batch.state[:] = self._start
        for args, kwargs in self._calls:
            self._rollout(*args, **kwargs)


def _compare_widths(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Print the rate of runtime, plant and judge at several widths, with all workers busy."""
    table = Table("robots in a shard", "robot-seconds per core-second", title=f"{WORKERS} workers at once")
    for robots in WIDTHS:
        seconds = np.median(_measure(WORKERS, _width_worker, spec.folder, policy, robots))
        table.add_row(str(robots), f"{robots * ROUND_S / seconds:.1f}")
    console.print(table)


def _width_worker(folder: Path, policy: Path, robots: int, _number: int, barrier: Any, sender: Any) -> None:
    spec = load_robot(folder)
    bench = StageBench(spec, policy, robots, every_stage=False)
    sender.send([_timed(lambda: bench.run(round(ROUND_S / spec.dt)), barrier) for _ in range(ROUNDS)])
