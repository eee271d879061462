"""soak-test: run the shipped runtime on simulated robots, each with its own draw, for contiguous hours."""

import time
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from deploy.command_line import BUDGET_EXCEEDED, INTERRUPTED, PASSED, main
from deploy.policy.policy import Policy
from eval.faults.schedule import FIRST_S, hours_max
from eval.faults.settings import FaultSettings
from eval.history.history import add_record, claim_history, read_history, same_task
from eval.history.soak_record import Run, SoakRecord
from eval.replay.bundle import DRAWS
from eval.replay.bundle_folders import delete_bundles, list_bundles, replace_bundles
from eval.replay.event_capture import EVENTS
from eval.report.build import build
from eval.report.report_files import claim_folder, delete_report, lock_folder, write_report
from eval.report.schema.report_data import Report
from eval.report.sections.trend import THIS_RUN, trend
from eval.shard.results import ShardResult
from eval.soak.assembly import assemble, settings
from eval.soak.checkpoint import delete_checkpoints
from eval.soak.configuration import SoakConfig
from eval.soak.disk import check_disk_space
from eval.soak.profile import Profile, load_profile
from eval.soak.series import SERIES, series
from eval.soak.tensorboard import TENSORBOARD, event_file
from eval.soak.workers import resumed_ticks, run_soak
from eval.statistics.budget import BUDGET, Budget, load_budget
from robots.errors import ConfigError
from robots.spec import load_robot

UNFINISHED = "unfinished"
"""Folder in --out of a soak that has not finished: checkpoints, events, and the report if it was interrupted."""
EXTRA_FILES = (DRAWS, SERIES, TENSORBOARD)
"""Files beside the report."""
DEFAULTS = Profile(meaning="options without a profile", hours=8.0, robots=32, budget=BUDGET.name)


def soak_test(
    policy: Annotated[Path, typer.Option(help="ONNX file from policy-export.")] = Path("out/arm.onnx"),
    robot: Annotated[str, typer.Option(help="Robot: a name or a folder.")] = "arm6",
    profile: Annotated[
        str | None,
        typer.Option(
            help="smoke, shift, nightly, faults, weekend or a file.toml; overridden by explicit options."
        ),
    ] = None,
    hours: Annotated[
        float | None, typer.Option(help="Simulated hours of each robot.", show_default="8, or the profile's")
    ] = None,
    robots: Annotated[
        int | None,
        typer.Option(help="Number of robots, each with its own draw.", show_default="32, or the profile's"),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of all draws, noise and goals.")] = 7,
    workers: Annotated[int, typer.Option(help="Number of processes; results do not depend on it.")] = 2,
    budget: Annotated[
        Path | None, typer.Option(help="TOML file of limits to pass.", show_default="the profile's")
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for report.json, report.html, junit.xml, draws.json, series.parquet, tensorboard/."
        ),
    ] = Path("out/soak"),
    history: Annotated[
        Path | None,
        typer.Option(
            help="Folder for a record of the finished soak; the report shows the trend over all records."
        ),
    ] = None,
) -> int:
    """Run the shipped runtime in simulation and write a report; exit code 1 if a budget was exceeded.

    An interrupted soak resumes when the same command is given again. The report of an earlier soak in --out is
    replaced only when this one has finished.
    """
    config = _configure(policy, robot, profile, hours, robots, seed, workers, budget)
    limits = load_budget(config.budget)
    claim_folder(out, EXTRA_FILES)
    with lock_folder(out):
        return _run(config, limits, out, history)


def _run(config: SoakConfig, limits: Budget, out: Path, history: Path | None) -> int:
    """Run the soak, or what is left of it, write the report and return the exit code."""
    console, earlier = Console(), None if history is None else _earlier_records(history, config)
    unfinished, started, clock = out / UNFINISHED, datetime.now().astimezone(), time.monotonic()
    resumed_hours = _prepare(config, out, console)
    shards = run_soak(config, unfinished, console)
    if not shards:
        return INTERRUPTED
    ticks = sum(int(shard.counts.ticks.sum()) for shard in shards) / config.robots
    run = Run(
        started=started.isoformat(timespec="seconds"),
        wall_s=round(time.monotonic() - clock, 1),
        hours=ticks * config.spec.dt / 3600,
        resumed_hours=resumed_hours,
        interrupted=ticks < config.ticks,
    )
    report = build(assemble(config, shards, run, list_bundles(unfinished / EVENTS)), limits)
    if earlier is not None and not run.interrupted:
        report = report.model_copy(update={"trend": trend({**earlier, THIS_RUN: report})})
    folder = unfinished if run.interrupted else out
    write_report(report, folder, _extra_files(config, shards, run))
    if not run.interrupted:
        if history is not None:
            add_record(report, history)
        _clean_up(out)
    _print_summary(report, folder / "report.html", console)
    return {"passed": PASSED, "failed": BUDGET_EXCEEDED, "interrupted": INTERRUPTED}[report.verdict]


def _extra_files(config: SoakConfig, shards: list[ShardResult], run: Run) -> dict[str, bytes]:
    return {
        DRAWS: config.draws_json(config.draw_robots()).encode(),
        SERIES: series(config, shards),
        TENSORBOARD: event_file(config, shards, run.started),
    }


def _print_summary(report: Report, page: Path, console: Console) -> None:
    pooled = f"\npooled with earlier soaks: {report.trend.last.statement}" if report.trend else ""
    console.print(f"{report.verdict}: {report.statement}{pooled}\nreport: {page}", soft_wrap=True)


def _configure(
    policy: Path,
    robot: str,
    profile: str | None,
    hours: float | None,
    robots: int | None,
    seed: int,
    workers: int,
    budget: Path | None,
) -> SoakConfig:
    """Combine profile and options, which override it."""
    defaults, default_budget = load_profile(profile) if profile else (DEFAULTS, BUDGET)
    hours = defaults.hours if hours is None else hours
    robots = defaults.robots if robots is None else robots
    _check_options(hours, robots, seed, workers, defaults.faults)
    spec = load_robot(robot)
    return SoakConfig(
        spec=spec,
        policy=Policy.load(policy, spec),
        policy_path=policy,
        budget=default_budget if budget is None else budget,
        hours=hours,
        robots=robots,
        seed=seed,
        workers=workers,
        faults=defaults.faults,
    )


def _prepare(config: SoakConfig, out: Path, console: Console) -> float:
    """Check checkpoints and disk space, and return the mean hours of each robot that an earlier start simulated."""
    unfinished = out / UNFINISHED
    hours = resumed_ticks(config, unfinished, console) * config.spec.dt / 3600 / len(config.jobs())
    if hours:
        console.print(f"resuming after {hours:.3g} of {config.hours:g} hours")
    check_disk_space(config, out, unfinished, console)
    delete_bundles(unfinished / EVENTS, finished=not hours)
    return hours


def _clean_up(out: Path) -> None:
    """Replace the events of an earlier soak, and delete checkpoints and the report of an interrupted run."""
    unfinished = out / UNFINISHED
    delete_report(unfinished, EXTRA_FILES)
    delete_checkpoints(unfinished)
    replace_bundles(unfinished / EVENTS, out / EVENTS)


def _earlier_records(history: Path, config: SoakConfig) -> dict[str, SoakRecord]:
    """Read the records in `history`, and check that one of this soak can be added."""
    claim_history(history)
    records = read_history(history)
    same_task(records, settings(config), "this soak")
    return records


def _check_options(hours: float, robots: int, seed: int, workers: int, faults: FaultSettings | None) -> None:
    cycle, longest = (FIRST_S + faults.cycle_s) / 3600 if faults else 0.0, hours_max(faults)
    bounds = (
        ("--hours", hours, 0 < hours <= longest, f"above 0 and at most {longest:.5g}"),
        ("--robots", robots, 1 <= robots <= 100_000, "from 1 to 100000"),
        ("--seed", seed, seed >= 0, "at least 0"),
        ("--workers", workers, 1 <= workers <= 1024, "from 1 to 1024"),
        ("--hours", hours, hours >= cycle, f"at least {cycle:.3g}: time for one fault"),
    )
    for name, value, valid, expected in bounds:
        if not valid:
            raise ConfigError(f"{name}: found {value}, expected {expected}")


def cli() -> None:
    """Entry point of `soak-test`."""
    main(soak_test)
