"""Timeline plot: one row for each robot."""

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from eval.report.plots.canvas import COOL, GRID, HARD, INK, SOFT, STYLE, WARM, canvas, segments, svg
from eval.report.sections.timeline import Timeline
from robots.arrays import Floats


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
