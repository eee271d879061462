"""HTML pages, each a single file without external resources: report.html, and the trend over a history."""

from collections import defaultdict
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from markupsafe import Markup

from deploy.reasons import Reason, describe
from eval.report.plots.bars import margins_plot, timeline_plot
from eval.report.plots.curves import TREND_QUANTITIES, goals_plot, heat_plot, trend_plot, wear_plot
from eval.report.schema.report_data import Report
from eval.report.schema.rows import EventRow
from eval.report.schema.trend_rows import Trend
from eval.report.sections.timeline import timeline
from eval.statistics.numbers import Number, figure

EVENTS_SHOWN = 500
MULTIPLE_FROM = 10.0
"""Load from which it is shown as a multiple of the limit instead of per cent."""
TEMPLATES = Path(__file__).parent


class Cell(NamedTuple):
    """Events of a monitor on one joint or the whole robot: those shown, and the number listed in report.json."""

    anchor: str
    joint: str | None
    shown: list[EventRow]
    listed: int


def render(report: Report) -> str:
    """Return the page of one soak."""
    return _template("template.html").render(
        r=report,
        plot=plots(report),
        joints=[channel.joint for channel in report.monitors[0].channels],
        cells=event_cells(report),
        unlisted=sum(row.unlisted for row in report.monitors),
        over=[line for line in report.budget if not line.passed],
        trend=report.trend,
        trend_plots=[] if report.trend is None else _trend_plots(report.trend),
    )


def render_history(trend: Trend, task: Mapping[str, str]) -> str:
    """Return the page of all soaks of a history; `task` is their common task by name."""
    return _template("history.html").render(r=None, trend=trend, trend_plots=_trend_plots(trend), task=task)


@cache
def _template(name: str) -> Template:
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        each.__name__: each
        for each in (percent, load_text, margin_text, figure, decimals, duration, interval_text, reason_text)
    }
    return environment.get_template(name)


def _trend_plots(trend: Trend) -> list[dict[str, str]]:
    """Plot over soaks of each quantity, with its title and its latest value in words."""
    last = trend.runs[-1]
    notes = (
        figure(last.rate.value, 2),
        percent(last.goals.value, 2),
        percent(last.availability.value, 2),
        figure(last.hottest_c.value),
    )
    return [
        {"title": quantity.title, "note": f"last {note}", "svg": Markup(trend_plot(trend, quantity))}
        for quantity, note in zip(TREND_QUANTITIES, notes, strict=True)
    ]


def plots(report: Report) -> dict[str, Markup | list[Markup]]:
    """Return every plot by its section."""
    wanted = next(line.allowed for line in report.budget if line.name == "goal_success") or 0.0
    top = max(max(line.max_c, line.peak_c or line.max_c) for line in report.heat)
    end_h = max(1e-3, *(robot.hours for robot in report.robots))
    judged = [row for row in report.monitors if row.unit and row.evaluations and row.load_histogram]
    return {
        "timeline": Markup(timeline_plot(timeline(report.robots, report.events, end_h), end_h)),
        "margins": Markup(margins_plot(judged) if judged else ""),
        "heat": [Markup(heat_plot(report.sample_h, line, 1.08 * top)) for line in report.heat],
        "wear": [Markup(wear_plot(report.sample_h, line)) for line in report.wear],
        "goals": Markup(goals_plot(report.goals.bins, wanted)),
    }


def event_cells(report: Report) -> dict[str, dict[str | None, Cell]]:
    """Return events by monitor, hard ones first, and joint; of each the earliest, those with a bundle first."""
    listed, cells = (
        defaultdict[tuple[str, str | None], list[EventRow]](list),
        dict[str, dict[str | None, Cell]](),
    )
    for event in report.events:
        listed[event.monitor, event.joint].append(event)
    share = EVENTS_SHOWN // max(1, len(listed))
    for number, row in sorted(enumerate(report.monitors), key=lambda item: not item[1].hard):
        for place, channel in enumerate(row.channels):
            if events := listed.get((row.name, channel.joint)):
                shown = sorted(events, key=lambda e: (e.bundle is None, e.start_h))[:share]
                cell = Cell(f"events-{number}-{place}", channel.joint, shown, len(events))
                cells.setdefault(row.name, {})[channel.joint] = cell
    return cells


def margin_text(load: float | None) -> str:
    """Format what a load leaves to the limit, as per cent or as a multiple of it."""
    if load is None or load >= MULTIPLE_FROM:
        return f"−{load_text(None if load is None else load - 1)}"
    return f"{100 * (1 - load):.0f} %".replace("-", "−")


def load_text(load: float | None, digits: int = 0) -> str:
    """Format a load as per cent of the limit, or as a multiple of it from `MULTIPLE_FROM` on."""
    return percent(load, digits) if load is None or load < MULTIPLE_FROM else f"{load:,.0f} ×"


def percent(share: float | None, digits: int = 0) -> str:
    """Format a share as per cent; `∞` for None."""
    return "∞" if share is None else f"{100 * share:.{digits}f} %"


def interval_text(interval: tuple[Number, Number]) -> str:
    """Format an interval; `–` for one without an upper end."""
    return "–" if interval[1] is None else f"{figure(interval[0], 2)} to {figure(interval[1], 2)}"


def duration(hours: float) -> str:
    """Format hours in a readable unit: h, min or s."""
    unit, worth = next((u, w) for u, w in (("h", 1), ("min", 60), ("s", 3600)) if hours * w >= 1 or u == "s")
    return f"{figure(hours * worth, 2)} {unit}"


def reason_text(name: str) -> str:
    """Return what a stop reason means, by its name in `Reason`."""
    return describe(Reason[name])


def decimals(value: float | None, unit: str) -> str:
    """Format a number with one decimal for per cent and two for other units; `–` for None."""
    return "–" if value is None else f"{value:.{1 if unit == '%' else 2}f}"
