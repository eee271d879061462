"""soak-test: run the shipped runtime on simulated robots, each with its own draw, for contiguous hours."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.start import INTERRUPTED
from deploy.telemetry.folder_lock import locked
from deploy.telemetry.output_files import check_folder, check_no_links
from deploy.telemetry.plain_console import plain_console
from eval.history.history import add_record, check_same_task, read_history
from eval.history.soak_record import Run, SoakRecord
from eval.replay.bundle import DRAWS
from eval.replay.bundle_files import copy_bundles, delete_bundles, list_bundles, remove_bundles
from eval.replay.event_capture import EVENTS
from eval.report.build import build
from eval.report.report_files import PAGE, check_report_folder, delete_report, describe, write_report
from eval.report.schema.report_data import Report
from eval.report.sections.trend import THIS_RUN, trend
from eval.shard.judging import ShardResult
from eval.soak import options
from eval.soak.assembly import assemble
from eval.soak.checkpoint import delete_checkpoints
from eval.soak.configuration import SoakConfig
from eval.soak.disk import check_disk_space
from eval.soak.series import SERIES, series
from eval.soak.tensorboard import TENSORBOARD, event_file
from eval.soak.workers import resumed_ticks, run_soak
from eval.statistics.budget import Budget, load_budget
from robots.errors import OutputError, ResultLostError, printable

UNFINISHED = "unfinished"
"""Folder in --out of a soak that has not finished: checkpoints, events, and the report if it was interrupted."""
EXTRA_FILES = (DRAWS, SERIES, TENSORBOARD)
"""Files beside the report."""
IN_BOTH = (EVENTS, os.path.dirname(TENSORBOARD))
FOLDERS = (UNFINISHED, *IN_BOTH, *(f"{UNFINISHED}/{name}" for name in IN_BOTH))
"""Folders in --out that this command makes, and in which it deletes or replaces files."""
EXIT_CODES = {"passed": PASSED, "failed": BUDGET_EXCEEDED, "interrupted": INTERRUPTED}


def soak_test(
    policy: options.PolicyFile = Path("out/arm.onnx"),
    robot: options.Robot = "arm6",
    profile: options.ProfileName = None,
    hours: options.Hours = None,
    robots: options.Robots = None,
    seed: options.Seed = 7,
    workers: options.Workers = 2,
    budget: options.BudgetFile = None,
    out: options.Out = Path("out/soak"),
    history: options.History = None,
) -> int:
    """Run the shipped runtime in simulation and write a report; exit code 1 if a budget was exceeded or a file lost.

    An interrupted soak resumes when the same command is given again. The report of an earlier soak in --out is
    replaced only when this one has finished.
    """
    config = options.configure(policy, robot, profile, hours, robots, seed, workers, budget)
    limits = load_budget(config.budget)
    check_no_links(out, FOLDERS)
    check_report_folder(out, EXTRA_FILES)
    with locked(out):
        return _run(config, limits, out, history)


def _run(config: SoakConfig, limits: Budget, out: Path, history: Path | None) -> int:
    """Run the soak, or what is left of it, write the report and return the exit code.

    Raises:
        ResultLostError: a checkpoint, an event or the report cannot be written.
    """
    console, earlier = plain_console(), None if history is None else _earlier_records(history, config)
    started, clock = datetime.now(UTC), time.monotonic()
    resumed_hours = _prepare(config, out, console)
    with _work_at_stake():
        shards = run_soak(config, out / UNFINISHED, console)
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
    report = build(assemble(config, shards, run, list_bundles(out / UNFINISHED / EVENTS)), limits)
    if earlier is not None and not run.interrupted:
        report = report.model_copy(update={"trend": trend({**earlier, THIS_RUN: report})})
    extra = _extra_files(config, shards, run)
    with _work_at_stake():
        page = _write(report, extra, out, history)
    pooled = f"\npooled with earlier soaks: {report.trend.last.statement}" if report.trend else ""
    missed = "".join(f"\nbudget: {describe(line)}" for line in report.budget if not line.passed)
    verdict = f"{report.verdict}: {report.statement}{missed}{pooled}"
    console.print(f"{verdict}\nreport: {printable(str(page))}", soft_wrap=True)
    return EXIT_CODES[report.verdict]


@contextmanager
def _work_at_stake() -> Iterator[None]:
    """Hours were spent on what cannot be written: that is no bad input."""
    try:
        yield
    except OutputError as e:
        raise ResultLostError(f"not kept: {e}\nthe same command goes on from the last checkpoints") from e


def _write(report: Report, extra: dict[str, bytes], out: Path, history: Path | None) -> Path:
    """Write the report and return its page; of a finished soak also the record, and delete what is unfinished."""
    check_no_links(out, FOLDERS)  # made since the soak began
    if report.run.interrupted:
        write_report(report, out / UNFINISHED, extra)
        return out / UNFINISHED / PAGE
    write_report(report, out, extra)
    # The soak can still go on from its checkpoints.
    copy_bundles(out / UNFINISHED / EVENTS, out / EVENTS)
    if history is not None:
        add_record(report, history)
    delete_report(out / UNFINISHED, EXTRA_FILES)
    delete_checkpoints(out / UNFINISHED)
    remove_bundles(out / UNFINISHED / EVENTS)
    return out / PAGE


def _extra_files(config: SoakConfig, shards: list[ShardResult], run: Run) -> dict[str, bytes]:
    return {
        DRAWS: config.draws_json(config.draw_robots()).encode(),
        SERIES: series(config, shards),
        TENSORBOARD: event_file(config, shards, run.started),
    }


def _prepare(config: SoakConfig, out: Path, console: Console) -> float:
    """Check checkpoints and disk space, and return the mean hours of each robot that an earlier start simulated."""
    unfinished = out / UNFINISHED
    for folder in (unfinished, out / EVENTS):
        if os.path.exists(folder):
            check_folder(folder)
    hours = resumed_ticks(config, unfinished, console) * config.spec.dt / 3600 / len(config.jobs())
    if hours:
        console.print(f"resuming after {hours:.3g} of {config.hours:g} hours")
    check_disk_space(config, out, unfinished, console)
    delete_bundles(unfinished / EVENTS, finished=not hours)
    return hours


def _earlier_records(history: Path, config: SoakConfig) -> dict[str, SoakRecord]:
    """Read the records in `history`, and check that one of this soak can be added."""
    check_folder(history, "--history")
    records = read_history(history)
    check_same_task(records, config.settings(), "this soak")
    return records


def cli() -> None:
    """Entry point of `soak-test`."""
    main(soak_test)
