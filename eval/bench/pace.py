"""How fast a night is beside bare physics, what a second worker is worth, and how wide a shard should be."""

import gc
import multiprocessing as mp
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from deploy.policy.policy import Policy
from eval.bench.stages import SEED, Bench
from eval.replay.event_capture import EventCapture
from eval.shard.job import WIDTH, ShardJob
from eval.shard.shard import Shard
from robots.spec import RobotSpec, load_robot

WORKERS = 2
WIDTHS = (8, 16, 32)
WARM_S, ROUND_S, ROUNDS = 10, 4, 9
"""s that shards live before the first round, s of a round (a goal's), and how many: shard and physics in turns, all
workers in step."""


def pace(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Time of shards as a soak lives them ÷ that of physics alone, side by side on the same cores."""
    one, two = (
        np.median(_crew(workers, _live, spec.folder, policy), axis=(0, 1)) for workers in (1, WORKERS)
    )
    whole, physics = two
    console.print(
        f"{WORKERS} workers, shards of {WIDTH}: {whole / physics:.2f} times as long as bare physics takes for the same"
        f" steps (at most 1.6); {ROUND_S * WIDTH * WORKERS / whole:.0f} robot-seconds a second"
    )
    console.print(f"{WORKERS} workers do {WORKERS * one[0] / whole:.2f} times the work of one (at least 1.8)")
    _widths(spec, policy, console)


def _crew(workers: int, live: Callable[..., None], *told: Any) -> NDArray[np.float64]:
    """(workers, ROUNDS, ...) s: what each worker measured, all of them in step."""
    context = mp.get_context("spawn")
    together, pipes = context.Barrier(workers), [context.Pipe(duplex=False) for _ in range(workers)]
    crew = [
        context.Process(target=live, args=(*told, number, together, into))
        for number, (_, into) in enumerate(pipes)
    ]
    for process in crew:
        process.start()
    found = np.array([out.recv() for out, _ in pipes])
    for process in crew:
        process.join()
    return found


def _live(folder: Path, policy: Path, number: int, together: Any, into: Any) -> None:
    """A worker: a shard and its capture, then the same steps of physics and nothing else, again and again."""
    spec = load_robot(folder)
    job = ShardJob(
        robot=folder,
        policy=policy,
        robot_digest=spec.digest,
        policy_digest=Policy.load(policy, spec).digest,
        seed=SEED,
        first=number * WIDTH,
        robots=WIDTH,
        ticks=round((WARM_S + ROUND_S * ROUNDS) / spec.dt),
        sample_ticks=round(60 / spec.dt),
    )
    with tempfile.TemporaryDirectory() as events:
        shard = Shard(job)
        capture = EventCapture(job, shard, Path(events))

        def shift(seconds: float) -> None:
            for _ in range(round(seconds / spec.dt)):
                shard.tick()
                capture.observe(shard)

        shift(WARM_S)
        gc.collect()
        gc.freeze()
        steps = Steps(shard.robot.plant.batch)
        into.send([_round(shift, steps, together) for _ in range(ROUNDS)])
        gc.unfreeze()


def _round(shift: Callable[[float], None], steps: "Steps", together: Any) -> tuple[float, float]:
    """Seconds that a shard takes for a round, and that its physics takes for the same steps."""
    steps.record()
    return _timed(lambda: shift(ROUND_S), together), _timed(steps.again, together)


def _timed(work: Callable[[], None], together: Any) -> float:
    """Seconds, begun by all workers at once and ended by each for itself."""
    together.wait()
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


class Steps:
    """What a batch was made to do, to do it again and nothing else."""

    def __init__(self, batch: Batch) -> None:
        """Listen to its rollouts, which go on as they would."""
        self._batch, self._rollout = batch, batch.rollout
        self._asked: list[tuple[tuple[Any, ...], dict[str, Any]]] = []
        batch.rollout = self._listen

    def _listen(self, *args: Any, **kwargs: Any) -> Any:
        self._asked.append((args, kwargs | {"control": kwargs["control"].copy()}))
        return self._rollout(*args, **kwargs)

    def record(self) -> None:
        """Begin anew, from the present state."""
        self._asked.clear()
        self._begin = self._batch.state.copy()

    def again(self) -> None:
        """All rollouts since, from the same state to the same state."""
        self._batch.state[:] = self._begin
        for args, kwargs in self._asked:
            self._rollout(*args, **kwargs)


def _widths(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Robot-seconds a core-second of runtime, plant and judge at several widths, every core at work."""
    table = Table("robots in a shard", "robot-seconds per core-second", title=f"{WORKERS} workers at once")
    for robots in WIDTHS:
        seconds = np.median(_crew(WORKERS, _wide, spec.folder, policy, robots))
        table.add_row(str(robots), f"{robots * ROUND_S / seconds:.1f}")
    console.print(table)


def _wide(folder: Path, policy: Path, robots: int, _number: int, together: Any, into: Any) -> None:
    """A worker: so many robots."""
    spec = load_robot(folder)
    bench = Bench(spec, policy, robots, every_stage=False)
    into.send([_timed(lambda: bench.run(round(ROUND_S / spec.dt)), together) for _ in range(ROUNDS)])
