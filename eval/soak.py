"""soak-test: the shipped runtime on simulated robots, each its own draw, for contiguous hours."""

import multiprocessing as mp
import platform
import signal
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from datetime import datetime
from functools import reduce
from importlib.metadata import version
from multiprocessing.sharedctypes import SynchronizedArray
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from deploy.cli import BUDGET_EXCEEDED, INTERRUPTED, PASSED, main
from deploy.output import replacing
from deploy.policy import Policy
from deploy.signals import handled
from eval.budget import BUDGET, load_budget
from eval.counts import merge
from eval.report.build import build
from eval.report.data import Run, Settings, SoakResult
from eval.report.write import claim, write
from eval.shard import WIDTH, Shard, ShardJob, ShardResult
from robots.distributions import load_distributions
from robots.draws import draw
from robots.errors import ConfigError
from robots.randomness import robot_seed
from robots.spec import RobotSpec, load_robot

SAMPLE_S = 60.0
"""s between two samples of heat, wear and goals, in a soak long enough for `SAMPLES` of them."""
SAMPLES, GOAL_BINS = 64, 8
LIBRARIES = ("mujoco", "pin", "ruckig", "filterpy", "onnxruntime", "numpy", "scipy")
UNSEEN = (
    "Links, gears and ground are rigid: nothing bends, rings, shakes or grows with its warmth.",
    "Friction depends on neither load nor warmth, and motors turn without cogging or ripple. Iron losses only warm:"
    " what they brake is taken as part of the joint's damping.",
    "Joints wear with the way they go and with warmth, and nothing breaks; brakes, cable, windings and links stay new.",
    "No sensor fails: readings are noisy, coarse, biased and drifting, packets late and lost, but no fault was"
    " scheduled. Nothing interferes with cables, and no encoder's error depends on the angle.",
    "Drives are ideal: current follows at once, and their software has no limits, filters or faults of its own."
    " Commands reach a drive late, always by the same time, and are never lost.",
    "The supply sags and never fails. Brakes are drives that hold.",
    "A payload appears at the tool and vanishes, a push is a force on one link, the cable a spring without weight:"
    " nothing is gripped, nobody is clamped, and there is nothing to bump into but the robot and its model's scene.",
    "The computer keeps every period: simulated time waits for it.",
    "An operator comes a minute after a robot latched and arms it again, without looking for the cause.",
    "The report counts what the simulation can show; a real robot has been nowhere in it.",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Soak:
    """What was asked for."""

    spec: RobotSpec
    policy: Policy
    policy_path: Path
    budget: Path
    hours: float
    robots: int
    seed: int
    workers: int

    @property
    def ticks(self) -> int:
        """Control ticks that each robot lives."""
        return max(1, round(self.hours * 3600 / self.spec.dt))

    @property
    def sample_ticks(self) -> int:
        """Control ticks between two samples."""
        return max(1, min(round(SAMPLE_S / self.spec.dt), self.ticks // SAMPLES))

    def jobs(self) -> list[ShardJob]:
        """Shards of `WIDTH` robots; the last may count fewer."""
        return [
            ShardJob(
                robot=self.spec.folder,
                policy=self.policy_path,
                robot_digest=self.spec.digest,
                policy_digest=self.policy.digest,
                seed=self.seed,
                first=start,
                robots=min(WIDTH, self.robots - start),
                ticks=self.ticks,
                sample_ticks=self.sample_ticks,
            )
            for start in range(0, self.robots, WIDTH)
        ]


# Of the worker process: set once, before its first shard.
_progress: "SynchronizedArray[int]"
_stop: Event


def _prepare(progress: "SynchronizedArray[int]", stop: Event) -> None:
    """Keep what the worker shares with its parent."""
    global _progress, _stop
    _progress, _stop = progress, stop


def _run(number: int, job: ShardJob) -> ShardResult | None:
    """One shard in a worker; None if the soak was interrupted before it began."""
    if _stop.is_set():
        return None

    def report(ticks: int) -> None:
        _progress[number] = ticks

    return Shard(job).run(report, _stop.is_set)


def run_soak(soak: Soak, console: Console) -> list[ShardResult]:
    """Run every shard and return their results in order; after Ctrl-C, what there is of them."""
    jobs, context = soak.jobs(), mp.get_context("spawn")
    progress, stop = context.Array("q", len(jobs)), context.Event()
    workers = min(soak.workers, len(jobs))
    with ProcessPoolExecutor(workers, context, initializer=_prepare, initargs=(progress, stop)) as pool:
        with handled(signal.SIG_IGN):  # which the workers inherit: only their parent hears Ctrl-C
            futures = [pool.submit(_run, number, job) for number, job in enumerate(jobs)]
        try:
            with handled(_interrupt):
                _watch(futures, progress, soak.ticks * len(jobs), console)
        except KeyboardInterrupt:
            console.print("interrupted: the report will hold what was done so far")
        finally:
            stop.set()
        with handled(signal.SIG_IGN):
            results = [future.result() for future in futures]
    return [result for result in results if result is not None]


def _interrupt(_signal: int, _frame: object) -> None:
    raise KeyboardInterrupt


def _watch(
    futures: "Sequence[Future[ShardResult | None]]",
    progress: "SynchronizedArray[int]",
    total: int,
    console: Console,
) -> None:
    """Show progress until every shard is done or one has failed."""
    columns = (
        TextColumn("soaking"),
        BarColumn(),
        TextColumn("{task.percentage:5.1f} %"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=console) as bar:
        task, pending = bar.add_task("", total=total), set(futures)
        while pending:
            done, pending = wait(pending, timeout=0.5)
            bar.update(task, completed=sum(progress[:]))
            for future in done:
                future.result()


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
    versions = {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}
    return Settings(
        command=" ".join(["soak-test", *sys.argv[1:]]),
        robot=soak.spec.name,
        robot_digest=soak.spec.digest,
        draws_digest=load_distributions(soak.spec).digest,
        policy=_shown(soak.policy_path),
        policy_digest=soak.policy.digest,
        budget=_shown(soak.budget),
        seed=soak.seed,
        hours=soak.hours,
        robots=soak.robots,
        shard_width=WIDTH,
        workers=soak.workers,
        versions=versions,
    )


def _shown(path: Path) -> str:
    """As a reader of the report knows it: from the folder the soak was started in, if it lies there."""
    here = Path.cwd()
    return str(path.resolve().relative_to(here) if path.resolve().is_relative_to(here) else path)


def soak_test(
    policy: Annotated[Path, typer.Option(help="ONNX file that policy-export wrote.")] = Path("out/arm.onnx"),
    robot: Annotated[str, typer.Option(help="Robot: a name or a folder.")] = "arm6",
    hours: Annotated[float, typer.Option(help="Simulated hours of each robot.")] = 8.0,
    robots: Annotated[int, typer.Option(help="Robots, each its own draw.")] = 16,
    seed: Annotated[int, typer.Option(help="Decides every draw, noise and goal.")] = 7,
    workers: Annotated[int, typer.Option(help="Processes; results do not depend on it.")] = 2,
    budget: Annotated[Path, typer.Option(help="TOML of what the soak may cost.")] = BUDGET,
    out: Annotated[
        Path, typer.Option(help="Folder for report.json, report.html, junit.xml, draws.json.")
    ] = Path("out/soak"),
) -> int:
    """Soak the shipped runtime in simulation and write a report; 1 if a budget was exceeded."""
    _check_options(hours, robots, seed, workers)
    limits, spec = load_budget(budget), load_robot(robot)
    soak = Soak(
        spec=spec,
        policy=Policy.load(policy, spec),
        policy_path=policy,
        budget=budget,
        hours=hours,
        robots=robots,
        seed=seed,
        workers=workers,
    )
    claim(out)
    _store_draws(soak, out / "draws.json")
    console, began, clock = Console(), datetime.now().astimezone(), time.monotonic()
    shards = run_soak(soak, console)
    if not shards:
        return INTERRUPTED
    lived = sum(int(shard.counts.ticks.sum()) for shard in shards) / soak.robots
    run = Run(
        started=began.isoformat(timespec="seconds"),
        wall_s=round(time.monotonic() - clock, 1),
        hours=lived * spec.dt / 3600,
        interrupted=lived < soak.ticks,
    )
    report = build(collect(soak, shards, run), limits)
    write(report, out)
    console.print(f"{report.verdict}: {report.statement}\nreport: {out / 'report.html'}", soft_wrap=True)
    return {"passed": PASSED, "failed": BUDGET_EXCEEDED, "interrupted": INTERRUPTED}[report.verdict]


def _store_draws(soak: Soak, path: Path) -> None:
    """Every robot as it is, so that it can be lived again whatever becomes of draws.toml."""
    seeds = [robot_seed(soak.seed, robot) for robot in range(soak.robots)]
    robots = draw(load_distributions(soak.spec), soak.spec, seeds)
    with replacing(path) as file:
        file.write_text(robots.to_json(soak.seed), encoding="utf-8")


def _check_options(hours: float, robots: int, seed: int, workers: int) -> None:
    bounds = (
        ("--hours", hours, 0 < hours <= 10_000, "above 0 and at most 10000"),
        ("--robots", robots, 1 <= robots <= 100_000, "from 1 to 100000"),
        ("--seed", seed, seed >= 0, "at least 0"),
        ("--workers", workers, 1 <= workers <= 1024, "from 1 to 1024"),
    )
    for name, value, fine, expected in bounds:
        if not fine:
            raise ConfigError(f"{name}: found {value}, expected {expected}")


def cli() -> None:
    """Entry point of `soak-test`."""
    main(soak_test)
