"""soak-report: compare two policies on the same draws, and show the trend over soaks."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Column, Table

from deploy.command_line import PASSED, main
from deploy.telemetry.output_files import check_no_input, check_no_links, replacing
from deploy.telemetry.plain_console import plain_console
from eval.history.history import check_same_draws, read_history, read_record, record_files
from eval.history.soak_record import SoakRecord
from eval.report.html import interval_text, percent, render_history
from eval.report.schema.report_data import Report
from eval.report.schema.trend_rows import Trend
from eval.report.sections.trend import trend as trend_of
from eval.statistics.compare import Difference
from eval.statistics.compare import compare as differences
from eval.statistics.numbers import figure
from robots.errors import ConfigError, printable

PAGE = "trend.html"
"""Name of the page of a trend in the folder of its records, which somebody else may have written."""
SoakPath = Annotated[Path, typer.Argument(help="report.json, its folder, or a record from --history.")]


def compare(a: SoakPath, b: SoakPath) -> int:
    """Compare policies A and B on the same draws.

    Differences are B - A, each with its 95 % interval.
    """
    console, first, second = plain_console(), read_record(a, Report), read_record(b, Report)
    check_same_draws(first, second, names=(str(a), str(b)))
    table = _plain_table("", "A", "B", "B − A", "from", "to", "conclusion", "differ")
    for each in differences(first.per_draw_counts, second.per_draw_counts):
        table.add_row(*_cells(each))
    for name, record in (("A", first), ("B", second)):
        console.print(printable(f"{name}: {_describe(record)}"), soft_wrap=True, highlight=False)
    console.print(table)
    return PASSED


def _describe(record: SoakRecord) -> str:
    s = record.settings
    return f"{s.policy} ({s.policy_digest:.12}) on {s.robots} draws of seed {s.seed}, {s.hours:g} h each"


def _cells(each: Difference) -> tuple[str, ...]:
    """Row of the table; shares in per cent, their differences in percentage points."""
    factor, unit, digits = (1.0, each.unit, 4) if each.unit else (100.0, "%", 3)
    a, b, difference, low, high = (
        f"{factor * value:.{digits}f}".replace("-", "−")
        for value in (each.a, each.b, each.b - each.a, each.low, each.high)
    )
    conclusion = "" if each.conclusion == "no difference" else each.conclusion
    differ = f"{each.differing} of {each.draws}"
    return f"{each.name}, {unit}", a, b, difference, low, high, conclusion, differ


def trend(
    folder: Annotated[Path, typer.Argument(help="Folder of records from soak-test --history.")],
    out: Annotated[
        Path | None, typer.Option(help="HTML page to write.", show_default="trend.html in the folder")
    ] = None,
) -> int:
    """Show the trend over soaks, as a page and on the console.

    Soaks with the same policy, code and versions are pooled.
    """
    records = read_history(folder)
    if not records:
        raise ConfigError(f"{folder}: found no records, expected some from soak-test --history")
    result, console = trend_of(records), plain_console()
    if out is None:
        check_no_links(folder, (PAGE,))
    page = out or folder / PAGE
    check_no_input(page, record_files(folder))
    with replacing(page) as file:
        task = next(iter(records.values())).settings.task
        file.write_text(render_history(result, task), encoding="utf-8")
    console.print(_trend_table(result))
    for number, group in enumerate(result.groups, start=1):
        line = f"{number}: {group.policy} ({group.policy_digest:.12}): {group.statement} {group.dispersion}"
        console.print(printable(line), soft_wrap=True, highlight=False)
    console.print(f"page: {printable(str(page))}", soft_wrap=True)
    return PASSED


def _plain_table(*names: str) -> Table:
    columns = (Column(name, no_wrap=True) for name in names)
    return Table(*columns, box=None, padding=(0, 2, 0, 0), pad_edge=False)


def _trend_table(result: Trend) -> Table:
    table = _plain_table(
        "started", "group", "verdict", "draws", "events", "per h, 95 %", "goals", "avail.", "°C"
    )
    for run in result.runs:
        table.add_row(
            run.started[:16].replace("T", " "),
            f"{run.group + 1}",
            "passed" if run.passed else "failed",
            f"{run.draws}",
            f"{run.hard_events}",
            interval_text((run.rate.low, run.rate.high)),
            percent(run.goals.value, 2),
            percent(run.availability.value, 2),
            figure(run.hottest_c.value),
        )
    return table


def cli() -> None:
    """Entry point of `soak-report`."""
    main(compare, trend)
