"""soak-test: the shipped runtime on simulated robots, each its own draw, for contiguous hours."""

import multiprocessing as mp
import signal
import time
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from datetime import datetime
from multiprocessing.sharedctypes import SynchronizedArray
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from deploy.cli import BUDGET_EXCEEDED, INTERRUPTED, PASSED, main
from deploy.output import replacing
from deploy.policy import Policy
from deploy.signals import handled
from eval.asked import Soak
from eval.budget import BUDGET, load_budget
from eval.collect import collect
from eval.report.build import build
from eval.report.data import Run
from eval.report.write import claim, write
from eval.shard import Shard, ShardJob, ShardResult
from robots.distributions import load_distributions
from robots.draws import draw
from robots.errors import ConfigError
from robots.randomness import robot_seed
from robots.spec import load_robot

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
    """Every robot as it is, so that it can be lived again whatever the spans of draws.toml become."""
    seeds = [robot_seed(soak.seed, robot) for robot in range(soak.robots)]
    distributions = load_distributions(soak.spec)
    robots = draw(distributions, soak.spec, seeds)
    with replacing(path) as file:
        file.write_text(robots.to_json(soak.seed, distributions, soak.spec), encoding="utf-8")


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
