"""soak-report: two policies on the same draws, and nights as they follow each other."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Column, Table

from deploy.command_line import PASSED, main
from deploy.telemetry.output_files import replacing
from eval.history.history import read_history, read_night
from eval.history.night_record import Night
from eval.report.html import ends, percent, render_nights
from eval.report.schema.numbers import figure
from eval.report.schema.trend_rows import Trend
from eval.report.sections.trend import trend as follow
from eval.statistics.compare import Difference
from eval.statistics.compare import compare as differences
from eval.statistics.pooling import same_draws
from robots.errors import ConfigError

Of = Annotated[Path, typer.Argument(help="report.json, the folder of one, or a night that --history kept.")]


def compare(a: Of, b: Of) -> int:
    """Tell policies A and B on the same draws apart.

    Differences are B less A, each with its interval at 95 %.
    """
    console, one, other = Console(), read_night(a), read_night(b)
    same_draws(one, other, names=(str(a), str(b)))
    table = _plain("", "A", "B", "B − A", "from", "to", "shown", "differ")
    for each in differences(one.tally, other.tally):
        table.add_row(*_cells(each))
    for name, night in (("A", one), ("B", other)):
        console.print(f"{name}: {_named(night)}", soft_wrap=True, markup=False, highlight=False)
    console.print(table)
    return PASSED


def _named(night: Night) -> str:
    s = night.settings
    return f"{s.policy} ({s.policy_digest:.12}) on {s.robots} draws of seed {s.seed}, {s.hours:g} h each"


def _cells(each: Difference) -> tuple[str, ...]:
    """Shares as per cent, their differences as points of it."""
    per, unit, digits = (1.0, each.unit, 4) if each.unit else (100.0, "%", 3)
    a, b, less, low, high = (
        f"{per * value:.{digits}f}".replace("-", "−")
        for value in (each.a, each.b, each.b - each.a, each.low, each.high)
    )
    shown = "" if each.shown == "no difference" else each.shown
    return f"{each.name}, {unit}", a, b, less, low, high, shown, f"{each.differing} of {each.draws}"


def trend(
    folder: Annotated[Path, typer.Argument(help="Folder that soak-test --history keeps nights in.")],
    out: Annotated[
        Path | None, typer.Option(help="Page to write.", show_default="trend.html in the folder")
    ] = None,
) -> int:
    """Show how nights follow each other.

    As a page, and what nights of one policy, code and versions say together.
    """
    nights = read_history(folder)
    if not nights:
        raise ConfigError(f"{folder}: found no night, expected some that soak-test --history keeps")
    found, console = follow(nights), Console()
    page = out or folder / "trend.html"
    with replacing(page) as file:
        file.write_text(render_nights(found, next(iter(nights.values())).settings.task), encoding="utf-8")
    console.print(_table(found))
    for number, group in enumerate(found.groups, start=1):
        said = f"{number}: {group.policy} ({group.policy_digest:.12}): {group.statement} {group.differ}"
        console.print(said, soft_wrap=True, markup=False, highlight=False)
    console.print(f"page: {page}", soft_wrap=True)
    return PASSED


def _plain(*names: str) -> Table:
    columns = (Column(name, no_wrap=True) for name in names)
    return Table(*columns, box=None, padding=(0, 2, 0, 0), pad_edge=False)


def _table(found: Trend) -> Table:
    table = _plain("started", "kind", "verdict", "draws", "events", "per h, 95 %", "goals", "up", "°C")
    for night in found.nights:
        table.add_row(
            night.started[:16].replace("T", " "),
            f"{night.group + 1}",
            "passed" if night.passed else "failed",
            f"{night.draws}",
            f"{night.hard_events}",
            ends((night.rate.low, night.rate.high)),
            percent(night.goals.value, 2),
            percent(night.availability.value, 2),
            figure(night.hottest_c.value),
        )
    return table


def cli() -> None:
    """Entry point of `soak-report`."""
    main(compare, trend)
