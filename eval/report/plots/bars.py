"""Plots of bars in rows: the load of every monitor as a histogram, and events and stops of every robot over time."""

from collections.abc import Iterator, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from eval.judge.counts import BINS_PER_LIMIT
from eval.report.plots.canvas import COOL, GRID, HARD, INK, SOFT, STYLE, WARM, canvas, svg
from eval.report.schema.rows import MonitorRow
from eval.report.sections.timeline import Timeline
from robots.arrays import Floats

DECADES = 9
"""Range of a strip: 64 robots with 6 joints have 2e9 ticks in 8 hours."""


def margins_plot(rows: Sequence[MonitorRow]) -> str:
    """Return a strip for each monitor, the logarithm of its ticks by margin, with the tail and worst of each joint."""
    worst = max([c.worst for row in rows for c in row.channels if c.worst is not None], default=0.0)
    right = min(2.0, max(1.1, worst)) + 0.05
    with mpl.rc_context(STYLE | {"path.simplify": False}):
        figure, axes = canvas(10.6, 0.6 + 0.31 * len(rows), left_in=1.35)
        axes.set(xlim=(0, right), ylim=(len(rows) - 0.2, -0.95), xlabel="margin: what is left to the limit")
        axes.axvline(1.0, color=HARD, linewidth=1.1)
        strips = [_strip(row, place) for place, row in enumerate(rows)]
        # Slightly wider than a bin, to avoid seams between neighbours.
        bin_pt = 1.03 * 72 * 10.6 * axes.get_position().width / right / BINS_PER_LIMIT
        for colour, parts in zip((COOL, SOFT, HARD), zip(*strips, strict=True), strict=True):
            at, foot, top = np.concatenate(parts).reshape(-1, 3).T
            segments(axes, (at, at), (foot, top), colour, bin_pt, alpha=0.45)
        for field, mark, size in (("tail", "o", 3.0), ("worst", "|", 7.0)):
            at, place = np.array([*_points(rows, field)]).reshape(-1, 2).T
            axes.plot(np.minimum(at, 2.0), place - 0.12, mark, color=WARM, markersize=size)
        axes.set_yticks(range(len(rows)), [row.name for row in rows])
        axes.xaxis.set_major_formatter(lambda load, _: f"{100 * (1 - load):.0f} %".replace("-", "−"))
        return svg(figure, "margins", "Margins of every monitor as distributions")


def _strip(row: MonitorRow, place: int) -> tuple[Floats, Floats, Floats]:
    """Bars (N, 3) of position, foot and top: inside the limit, beyond it (soft), beyond it (hard).

    A full strip is all ticks, an empty one fewer than 1 in 10 to the power of `DECADES`.
    """
    ticks = np.array(row.load_histogram, dtype=float)
    share = ticks / ticks.sum()
    used = np.flatnonzero(share > 0.1**DECADES)
    top = place - 0.8 * (1 + np.log10(share[used]) / DECADES)
    bars = np.stack((used / BINS_PER_LIMIT + 0.5 / BINS_PER_LIMIT, np.full(len(used), place), top), axis=1)
    inside, none = used < BINS_PER_LIMIT, np.zeros((0, 3))
    beyond = bars[~inside]
    return bars[inside], (none if row.hard else beyond), (beyond if row.hard else none)


def _points(rows: Sequence[MonitorRow], field: str) -> Iterator[tuple[float, int]]:
    for place, row in enumerate(rows):
        loads = [getattr(channel, field) for channel in row.channels]
        yield from ((load, place) for load in loads if load is not None)


def timeline_plot(timeline: Timeline, end_h: float) -> str:
    """Return the plot with the first robot on top: events in the upper half of its row, stops in the lower half."""
    rows = len(timeline.judged)
    height = min(6.4, 0.55 + max(0.5, 0.17 * rows))
    with mpl.rc_context(STYLE | {"axes.grid": False, "path.simplify": False}):
        figure, axes = canvas(10.6, height)
        lane = 72 * (height - 0.47) / rows  # points
        _bars(axes, timeline.judged, GRID, 0.86 * lane, alpha=0.55)
        _bars(axes, timeline.diverged, INK, 0.86 * lane, alpha=0.55)
        _bars(axes, timeline.unlisted, SOFT, 0.43 * lane, up=-0.215, alpha=0.3)
        _bars(axes, timeline.soft, SOFT, 0.43 * lane, up=-0.215)
        _bars(axes, timeline.stops, COOL, 0.43 * lane, up=0.215)
        _bars(axes, timeline.latches, WARM, 0.43 * lane, up=0.215)
        # On top of all others, and never too thin to be seen.
        _bars(axes, timeline.hard, HARD, max(2.5, 0.43 * lane), up=-0.215)
        axes.set(xlim=(0, end_h), ylim=(rows - 0.5, -0.5), xlabel="h", ylabel="robot")
        axes.yaxis.set_major_locator(MaxNLocator(nbins=16, integer=True))
        axes.spines["left"].set_visible(False)
        return svg(figure, "timeline", "Events and stops of each robot over time")


def _bars(axes: Axes, bars: Floats, colour: str, width: float, up: float = 0.0, alpha: float = 1.0) -> None:
    """Bars (N, 3) of robot, begin and end, `width` points high."""
    robot, begin, end = bars.T
    segments(axes, (begin, end), (robot + up, robot + up), colour, width, alpha)


def segments(
    axes: Axes, x: tuple[Floats, Floats], y: tuple[Floats, Floats], colour: str, width: float, alpha: float
) -> None:
    """Draw straight strokes from (N,) to (N,) as one path, which keeps the page small."""
    gap = np.full(len(x[0]), np.nan)
    paths = [np.stack((*ends, gap), axis=1).ravel() for ends in (x, y)]
    axes.plot(*paths, color=colour, linewidth=width, alpha=alpha, solid_capstyle="butt")
