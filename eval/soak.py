"""soak-test: the shipped runtime on simulated robots, each its own draw, for contiguous hours."""

import time
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from deploy.cli import BUDGET_EXCEEDED, INTERRUPTED, PASSED, main
from deploy.output import replacing
from deploy.policy import Policy
from eval.asked import Soak
from eval.budget import BUDGET, load_budget
from eval.collect import collect
from eval.report.build import build
from eval.report.data import Run
from eval.report.write import claim, write
from eval.resume import clear
from eval.workers import run_soak, take_up
from robots.distributions import load_distributions
from robots.draws import draw
from robots.errors import ConfigError
from robots.randomness import robot_seed
from robots.spec import load_robot

KEPT = "kept"
"""Folder inside --out where shards are kept while they live."""


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
    """Soak the shipped runtime in simulation and write a report; 1 if a budget was exceeded.

    A soak that was cut short, by whatever, goes on where it was when the same command is given again.
    """
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
    console, began, clock = Console(), datetime.now().astimezone(), time.monotonic()
    taken_up = take_up(soak, out / KEPT, console) * soak.spec.dt / 3600 / len(soak.jobs())
    if taken_up:
        console.print(f"going on after {taken_up:.3g} of {hours:g} hours, which an earlier start left behind")
    _store_draws(soak, out / "draws.json")
    shards = run_soak(soak, out / KEPT, console)
    if not shards:
        return INTERRUPTED
    lived = sum(int(shard.counts.ticks.sum()) for shard in shards) / soak.robots
    run = Run(
        started=began.isoformat(timespec="seconds"),
        wall_s=round(time.monotonic() - clock, 1),
        hours=lived * spec.dt / 3600,
        resumed_hours=taken_up,
        interrupted=lived < soak.ticks,
    )
    report = build(collect(soak, shards, run), limits)
    write(report, out)
    if not run.interrupted:
        clear(out / KEPT)
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
