"""Plots as SVG text that takes its colours from the page: one picture serves light, dark and paper."""

import html
import io
import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from eval.judge.counts import BINS_PER_LIMIT
from eval.report.schema.numbers import Number
from eval.report.schema.report_data import GoalBin, Heat, Wear
from eval.report.schema.rows import MonitorRow
from eval.report.schema.trend_rows import Span, Trend
from eval.report.sections.timeline import Timeline
from robots.arrays import Floats

# Colours that matplotlib writes, and the page's own that take their place.
INK, GRID, COOL, WARM, SOFT, HARD = "#010101", "#020202", "#030303", "#040404", "#050505", "#060606"
PAGE = {
    INK: "var(--muted)",
    GRID: "var(--line)",
    COOL: "var(--series-1)",
    WARM: "var(--series-2)",
    SOFT: "var(--warn)",
    HARD: "var(--bad)",
}
DECADES = 9
"""That a strip of margins spans: 64 robots of 6 joints have 2e9 ticks in 8 hours."""
WEAR_SHOWN = {
    "friction": (100.0, 101.0),
    "backlash": (0.0, 0.1),
    "encoder error": (0.0, 0.1),
    "torque constant": (99.0, 100.0),
}
"""What the scale of each quantity's plot holds at least."""


class Shown(NamedTuple):
    """A number of every night: its name there, and how many of its unit are one of the record's."""

    name: str
    title: str
    per: float


NIGHTS_SHOWN = (
    Shown("rate", "Hard events per hour", 1.0),
    Shown("goals", "Goals reached, %", 100.0),
    Shown("availability", "Availability, %", 100.0),
    Shown("hottest_c", "Hottest winding, °C", 1.0),
)
STYLE: Any = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GRID,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "lines.solid_capstyle": "round",
}


def heat_plot(hours: Sequence[float], heat: Heat, top_c: float) -> str:
    """Winding temperature of one joint over the night, up to `top_c` °C."""
    with mpl.rc_context(STYLE):
        figure, axes = _canvas(3.3, 2.0)
        _limit(axes, heat.max_c, HARD, f"hard {heat.max_c:g}")
        _limit(axes, heat.soft_c, SOFT, f"soft {heat.soft_c:g}")
        hottest, median = _curves(axes, hours, heat.median_c, heat.hottest_c)
        axes.fill_between(hours, median, hottest, color=WARM, alpha=0.15, linewidth=0)
        axes.set_ylim(bottom=min(20.0, np.nanmin(median, initial=20.0)), top=top_c)
        axes.set_ylabel("°C")
        return _svg(figure, f"heat-{heat.joint}", f"Winding temperature of {heat.joint} over time")


def wear_plot(hours: Sequence[float], wear: Wear) -> str:
    """A quantity that wears over the night, on a scale that shows no change where there is next to none."""
    with mpl.rc_context(STYLE):
        figure, axes = _canvas(2.7, 1.8)
        axes.update_datalim([(0.0, bound) for bound in WEAR_SHOWN[wear.name]])
        _curves(axes, hours, wear.median, wear.most_worn)
        axes.locator_params(nbins=4)
        return _svg(figure, f"wear-{wear.name}", f"{wear.name.capitalize()} over time")


def goals_plot(bins: Sequence[GoalBin], wanted: float) -> str:
    """Share of goals reached in each bin with its 95 % interval, and the share that the budget wants."""
    with mpl.rc_context(STYLE):
        figure, axes = _canvas(4.4, 2.3)
        used = [b for b in bins if b.attempted]
        at = np.array([(b.start_h + b.end_h) / 2 for b in used])
        share = np.array([b.reached / b.attempted for b in used])
        low, high = np.array([b.low for b in used]), np.array([b.high for b in used])
        _limit(axes, 100 * wanted, SOFT, f"budget {100 * wanted:g} %", below=wanted > 0.1)
        spread = 100 * np.maximum([share - low, high - share], 0.0)
        axes.errorbar(at, 100 * share, spread, fmt="o", color=COOL, markersize=4.5, elinewidth=1.4)
        axes.set_ylim(max(-1.0, 100 * low.min(initial=wanted) - 2), 100.5)
        axes.set_xlim(0, max([b.end_h for b in bins], default=1.0))
        axes.set_xlabel("h")
        axes.set_ylabel("% of goals")
        return _svg(figure, "goals", "Share of goals reached over time")


def nights_plot(trend: Trend, shown: Shown) -> str:
    """A number of every night with its interval, by what was under test, and bounds of nights put together."""
    spans: list[Span] = [getattr(night, shown.name) for night in trend.nights]
    ends = [[s.value if end is None else end for end in (s.value, s.low, s.high)] for s in spans]
    value, low, high = shown.per * np.array(ends, dtype=float).T
    at = np.arange(len(spans))
    colours = [(COOL, WARM)[night.group % 2] for night in trend.nights]
    points = [colour if night.passed else HARD for colour, night in zip(colours, trend.nights, strict=True)]
    days = [night.started[5:10] for night in trend.nights]
    with mpl.rc_context(STYLE):
        figure, axes = _canvas(2.7, 1.8)
        axes.vlines(at, low, high, colors=colours, linewidth=1.4)
        axes.scatter(at, value, s=18, c=points, zorder=3)
        if shown.name == "rate":
            _bounds(axes, trend)
            axes.set_ylim(bottom=-0.05 * axes.get_ylim()[1])
        axes.set_xlim(-0.6, len(spans) - 0.4)
        axes.xaxis.set_major_locator(MaxNLocator(4, integer=True, min_n_ticks=1))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: days[int(x)] if 0 <= x < len(days) else ""))
        axes.locator_params(axis="y", nbins=5)
        axes.set_xlabel("month-day")
        return _svg(figure, f"nights-{shown.name}", f"{shown.title}, night by night")


def _bounds(axes: Axes, trend: Trend) -> None:
    """Of several nights together, from the first to the last of them."""
    for number, group in enumerate(trend.groups):
        at = [k for k, night in enumerate(trend.nights) if night.group == number]
        if group.nights > 1 and group.draw_rate_upper is not None:
            axes.hlines(group.draw_rate_upper, at[0] - 0.4, at[-1] + 0.4, colors=SOFT, linewidth=1.4)


def timeline_plot(night: Timeline, end_h: float) -> str:
    """A row for each robot, first to last from above: events in its upper half, stops in its lower."""
    many = len(night.lived)
    height = min(6.4, 0.55 + max(0.5, 0.17 * many))
    with mpl.rc_context(STYLE | {"axes.grid": False, "path.simplify": False}):
        figure, axes = _canvas(10.6, height)
        lane = 72 * (height - 0.47) / many  # points
        _bars(axes, night.lived, GRID, 0.86 * lane, alpha=0.55)
        _bars(axes, night.lost, INK, 0.86 * lane, alpha=0.55)
        _bars(axes, night.unlisted, SOFT, 0.43 * lane, up=-0.215, alpha=0.3)
        _bars(axes, night.soft, SOFT, 0.43 * lane, up=-0.215)
        _bars(axes, night.stops, COOL, 0.43 * lane, up=0.215)
        _bars(axes, night.latches, WARM, 0.43 * lane, up=0.215)
        # Over everything, and never too thin to be seen.
        _bars(axes, night.hard, HARD, max(2.5, 0.43 * lane), up=-0.215)
        axes.set(xlim=(0, end_h), ylim=(many - 0.5, -0.5), xlabel="h", ylabel="robot")
        axes.yaxis.set_major_locator(MaxNLocator(nbins=16, integer=True))
        axes.spines["left"].set_visible(False)
        return _svg(figure, "timeline", "When each robot had events and stops")


def margins_plot(rows: Sequence[MonitorRow]) -> str:
    """A strip for each monitor: how many ticks left which margin, as a logarithm; and each joint's tail and worst."""
    most = max([c.worst for row in rows for c in row.channels if c.worst is not None], default=0.0)
    right = min(2.0, max(1.1, most)) + 0.05
    with mpl.rc_context(STYLE | {"path.simplify": False}):
        figure, axes = _canvas(10.6, 0.6 + 0.31 * len(rows), left_in=1.35)
        axes.set(xlim=(0, right), ylim=(len(rows) - 0.2, -0.95), xlabel="margin: what is left to the limit")
        axes.axvline(1.0, color=HARD, linewidth=1.1)
        strips = [_strip(row, place) for place, row in enumerate(rows)]
        # A hair wider than a bin: neighbours shall leave no seam.
        bin_pt = 1.03 * 72 * 10.6 * axes.get_position().width / right / BINS_PER_LIMIT
        for colour, parts in zip((COOL, SOFT, HARD), zip(*strips, strict=True), strict=True):
            at, foot, top = np.concatenate(parts).reshape(-1, 3).T
            _segments(axes, (at, at), (foot, top), colour, bin_pt, alpha=0.45)
        for what, mark in (("tail", "o"), ("worst", "|")):
            at, place = np.array([*_points(rows, what)]).reshape(-1, 2).T
            size = 3.0 if mark == "o" else 7.0
            axes.plot(np.minimum(at, 2.0), place - 0.12, mark, color=WARM, markersize=size)
        axes.set_yticks(range(len(rows)), [row.name for row in rows])
        axes.xaxis.set_major_formatter(lambda load, _: f"{100 * (1 - load):.0f} %".replace("-", "−"))
        return _svg(figure, "margins", "Margins of every monitor as distributions")


def _strip(row: MonitorRow, place: int) -> tuple[Floats, Floats, Floats]:
    """Bars (N, 3) of bins in which ticks lie, at, foot and top: inside the limit, and beyond it soft and hard.

    A full strip is all ticks, an empty one fewer than 1 in 10 to the power of `DECADES`.
    """
    ticks = np.array(row.loads, dtype=float)
    share = ticks / ticks.sum()
    some = np.flatnonzero(share > 0.1**DECADES)
    top = place - 0.8 * (1 + np.log10(share[some]) / DECADES)
    bars = np.stack((some / BINS_PER_LIMIT + 0.5 / BINS_PER_LIMIT, np.full(len(some), place), top), axis=1)
    inside, none = some < BINS_PER_LIMIT, np.zeros((0, 3))
    beyond = bars[~inside]
    return bars[inside], (none if row.hard else beyond), (beyond if row.hard else none)


def _points(rows: Sequence[MonitorRow], what: str) -> Iterator[tuple[float, int]]:
    for place, row in enumerate(rows):
        loads = [getattr(channel, what) for channel in row.channels]
        yield from ((load, place) for load in loads if load is not None)


def _bars(axes: Axes, bars: Floats, colour: str, width: float, up: float = 0.0, alpha: float = 1.0) -> None:
    """Bars (N, 3) of robot, begin and end, `width` points high."""
    robot, begin, end = bars.T
    _segments(axes, (begin, end), (robot + up, robot + up), colour, width, alpha)


def _segments(
    axes: Axes, x: tuple[Floats, Floats], y: tuple[Floats, Floats], colour: str, width: float, alpha: float
) -> None:
    """Many straight strokes from (N,) to (N,) as one path, which keeps the page small."""
    gap = np.full(len(x[0]), np.nan)
    places = [np.stack((*ends, gap), axis=1).ravel() for ends in (x, y)]
    axes.plot(*places, color=colour, linewidth=width, alpha=alpha, solid_capstyle="butt")


def _curves(axes: Axes, hours: Sequence[float], median: Sequence[Number], most: Sequence[Number]) -> Floats:
    """The extreme, and over it the median: both are returned."""
    lines = np.array((most, median), dtype=float)
    for line, colour in zip(lines, (WARM, COOL), strict=True):
        axes.plot(hours, line, color=colour, linewidth=1.4, marker="." if len(hours) < 2 else None)
    axes.set_xlim(0, max([*hours, 1e-3]))
    axes.set_xlabel("h")
    return lines


def _canvas(width: float, height: float, left_in: float = 0.5) -> tuple[Figure, Axes]:
    """A figure of some inches and its axes, with room for tick labels and units, also for half of one at the right."""
    figure = Figure(figsize=(width, height))
    left, bottom, right = left_in / width, 0.42 / height, 0.24 / width
    axes = figure.add_axes((left, bottom, 1 - left - right, 1 - bottom - 0.05 / height))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    return figure, axes


def _limit(axes: Axes, value: float, colour: str, text: str, *, below: bool = False) -> None:
    axes.axhline(value, color=colour, linewidth=1.1, linestyle=(0, (4, 3)))
    away, side = (-2, "top") if below else (2, "bottom")
    axes.annotate(
        text, (0, value), xytext=(4, away), textcoords="offset points", va=side, color=colour, fontsize=8
    )


def _svg(figure: Figure, name: str, label: str) -> str:
    """SVG text with ids of its own, the page's colours and no size but its proportions."""
    file, said = io.StringIO(), f'role="img" aria-label="{html.escape(label)}"'
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None})
    text = file.getvalue()[file.getvalue().index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    prefix = re.sub(r"\W", "-", name) + "-"
    text = re.sub(r'\bid="|url\(#|href="#', lambda found: found[0] + prefix, text)
    text = re.sub(r"<svg [^>]*?(viewBox=\"[^\"]*\")[^>]*>", lambda found: f"<svg {found[1]} {said}>", text)
    for ours, page in PAGE.items():
        text = text.replace(ours, page)
    return text
