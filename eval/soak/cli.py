"""soak-test: the shipped runtime on simulated robots, each its own draw, for contiguous hours."""

import time
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from deploy.command_line import BUDGET_EXCEEDED, INTERRUPTED, PASSED, main
from deploy.policy.policy import Policy
from eval.faults.schedule import FIRST_S, hours_max
from eval.history.history import claim_history, keep, read_history, same_task
from eval.history.night_record import Night, Run
from eval.replay.bundle import DRAWS, bundles, clear_bundles, move_bundles
from eval.replay.event_capture import EVENTS
from eval.report.assembly import collect, settings
from eval.report.build import build
from eval.report.sections.trend import TONIGHT, trend
from eval.report.series import SERIES, series
from eval.report.trends import TRENDS, trends
from eval.report.write import alone, claim, erase, write
from eval.soak.checkpoint import clear
from eval.soak.configuration import Soak
from eval.soak.disk import check_room
from eval.soak.profile import Faults, Profile, load_profile
from eval.soak.workers import run_soak, take_up
from eval.statistics.budget import BUDGET, Budget, load_budget
from robots.distributions import load_distributions
from robots.errors import ConfigError
from robots.spec import load_robot

KEPT = "kept"
"""Folder inside --out of a soak that is not over: its shards, its events, and its report if it was interrupted."""
BESIDE = (DRAWS, SERIES, TRENDS)
"""What is written beside a report."""
USUAL = Profile(meaning="what is asked for without a profile", hours=8.0, robots=32, budget=BUDGET.name)


def soak_test(
    policy: Annotated[Path, typer.Option(help="ONNX file that policy-export wrote.")] = Path("out/arm.onnx"),
    robot: Annotated[str, typer.Option(help="Robot: a name or a folder.")] = "arm6",
    profile: Annotated[
        str | None,
        typer.Option(help="smoke, shift, nightly, faults, weekend or a file.toml; options go before it."),
    ] = None,
    hours: Annotated[
        float | None, typer.Option(help="Simulated hours of each robot.", show_default="8, or the profile's")
    ] = None,
    robots: Annotated[
        int | None, typer.Option(help="Robots, each its own draw.", show_default="32, or the profile's")
    ] = None,
    seed: Annotated[int, typer.Option(help="Decides every draw, noise and goal.")] = 7,
    workers: Annotated[int, typer.Option(help="Processes; results do not depend on it.")] = 2,
    budget: Annotated[
        Path | None, typer.Option(help="TOML of what the soak may cost.", show_default="the profile's")
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for report.json, report.html, junit.xml, draws.json, series.parquet, tensorboard/."
        ),
    ] = Path("out/soak"),
    history: Annotated[
        Path | None,
        typer.Option(help="Folder to keep the finished night in; the report shows it beside earlier ones."),
    ] = None,
) -> int:
    """Soak the shipped runtime in simulation and write a report; 1 if a budget was exceeded.

    A soak that was cut short, by whatever, goes on where it was when the same command is given again. Until a soak is
    over, what an earlier one left in --out stays there.
    """
    soak = _asked(policy, robot, profile, hours, robots, seed, workers, budget)
    limits = load_budget(soak.budget)
    claim(out, BESIDE)
    with alone(out):
        return _soaked(soak, limits, out, history)


def _soaked(soak: Soak, limits: Budget, out: Path, history: Path | None) -> int:
    """Live through what was asked for, or what is left of it, and report; the exit code."""
    console, earlier = Console(), None if history is None else _earlier(history, soak)
    kept, began, clock = out / KEPT, datetime.now().astimezone(), time.monotonic()
    taken_up = _take_up(soak, out, console)
    shards = run_soak(soak, kept, console)
    if not shards:
        return INTERRUPTED
    lived = sum(int(shard.counts.ticks.sum()) for shard in shards) / soak.robots
    run = Run(
        started=began.isoformat(timespec="seconds"),
        wall_s=round(time.monotonic() - clock, 1),
        hours=lived * soak.spec.dt / 3600,
        resumed_hours=taken_up,
        interrupted=lived < soak.ticks,
    )
    report = build(collect(soak, shards, run, bundles(kept / EVENTS)), limits)
    if earlier is not None and not run.interrupted:
        report = report.model_copy(update={"trend": trend({**earlier, TONIGHT: report})})
    beside = {DRAWS: _draws(soak), SERIES: series(soak, shards), TRENDS: trends(soak, shards, run.started)}
    place = kept if run.interrupted else out
    write(report, place, beside)
    if not run.interrupted:
        if history is not None:
            keep(report, history)
        _settle(out)
    together = f"\nnights like it: {report.trend.last.statement}" if report.trend else ""
    page = place / "report.html"
    console.print(f"{report.verdict}: {report.statement}{together}\nreport: {page}", soft_wrap=True)
    return {"passed": PASSED, "failed": BUDGET_EXCEEDED, "interrupted": INTERRUPTED}[report.verdict]


def _asked(
    policy: Path,
    robot: str,
    profile: str | None,
    hours: float | None,
    robots: int | None,
    seed: int,
    workers: int,
    budget: Path | None,
) -> Soak:
    """What the options ask for, which go before what their profile says."""
    usual, its_budget = load_profile(profile) if profile else (USUAL, BUDGET)
    hours, robots = (usual.hours if hours is None else hours), (usual.robots if robots is None else robots)
    _check_options(hours, robots, seed, workers, usual.faults)
    spec = load_robot(robot)
    return Soak(
        spec=spec,
        policy=Policy.load(policy, spec),
        policy_path=policy,
        budget=its_budget if budget is None else budget,
        hours=hours,
        robots=robots,
        seed=seed,
        workers=workers,
        faults=usual.faults,
    )


def _take_up(soak: Soak, out: Path, console: Console) -> float:
    """Hours of each robot, on average, that an earlier start left in `out`, which is made ready for the others."""
    hours = take_up(soak, out / KEPT, console) * soak.spec.dt / 3600 / len(soak.jobs())
    if hours:
        console.print(
            f"going on after {hours:.3g} of {soak.hours:g} hours, which an earlier start left behind"
        )
    check_room(soak, out, out / KEPT, console)
    clear_bundles(out / KEPT / EVENTS, all_of_them=not hours)
    return hours


def _settle(out: Path) -> None:
    """The soak is over and its report written: its events take the place of earlier ones, and nothing is kept."""
    erase(out / KEPT, BESIDE)
    clear(out / KEPT)
    move_bundles(out / KEPT / EVENTS, out / EVENTS)


def _earlier(history: Path, soak: Soak) -> dict[str, Night]:
    """The nights of `history`, which can hold one more of the same task."""
    claim_history(history)
    nights = read_history(history)
    same_task(nights, settings(soak), "this soak")
    return nights


def _draws(soak: Soak) -> bytes:
    """Every robot as it is, so that it can be lived again whatever the spans of draws.toml become."""
    return soak.drawn().to_json(soak.seed, load_distributions(soak.spec), soak.spec).encode()


def _check_options(hours: float, robots: int, seed: int, workers: int, faults: Faults | None) -> None:
    cycle, most = (FIRST_S + faults.cycle_s) / 3600 if faults else 0.0, hours_max(faults)
    bounds = (
        ("--hours", hours, 0 < hours <= most, f"above 0 and at most {most:.5g}"),
        ("--robots", robots, 1 <= robots <= 100_000, "from 1 to 100000"),
        ("--seed", seed, seed >= 0, "at least 0"),
        ("--workers", workers, 1 <= workers <= 1024, "from 1 to 1024"),
        ("--hours", hours, hours >= cycle, f"at least {cycle:.3g}: time for one fault"),
    )
    for name, value, fine, expected in bounds:
        if not fine:
            raise ConfigError(f"{name}: found {value}, expected {expected}")


def cli() -> None:
    """Entry point of `soak-test`."""
    main(soak_test)
