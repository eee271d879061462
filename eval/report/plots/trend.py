"""Plots of the trend over soaks."""

from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MaxNLocator

from eval.report.plots.canvas import COOL, HARD, SOFT, STYLE, WARM, canvas, svg
from eval.report.schema.trend_rows import Estimate, Trend


class TrendQuantity(NamedTuple):
    """A field of `RunRow` to plot; `factor` converts it to the unit of the title."""

    field: str
    title: str
    factor: float


TREND_QUANTITIES = (
    TrendQuantity("rate", "Hard events per hour", 1.0),
    TrendQuantity("goals", "Goals reached, %", 100.0),
    TrendQuantity("availability", "Availability, %", 100.0),
    TrendQuantity("hottest_c", "Hottest winding, °C", 1.0),
)


def trend_plot(trend: Trend, quantity: TrendQuantity) -> str:
    """Return the plot of one quantity of every soak with its interval, coloured by group, and pooled bounds."""
    estimates: list[Estimate] = [getattr(run, quantity.field) for run in trend.runs]
    ends = [[s.value if end is None else end for end in (s.value, s.low, s.high)] for s in estimates]
    value, low, high = quantity.factor * np.array(ends, dtype=float).T
    at = np.arange(len(estimates))
    colours = [(COOL, WARM)[run.group % 2] for run in trend.runs]
    points = [colour if run.passed else HARD for colour, run in zip(colours, trend.runs, strict=True)]
    days = [run.started[5:10] for run in trend.runs]
    with mpl.rc_context(STYLE):
        figure, axes = canvas(2.7, 1.8)
        axes.vlines(at, low, high, colors=colours, linewidth=1.4)
        axes.scatter(at, value, s=18, c=points, zorder=3)
        if quantity.field == "rate":
            _pooled_bounds(axes, trend)
            axes.set_ylim(bottom=-0.05 * axes.get_ylim()[1])
        axes.set_xlim(-0.6, len(estimates) - 0.4)
        axes.xaxis.set_major_locator(MaxNLocator(4, integer=True, min_n_ticks=1))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: days[int(x)] if 0 <= x < len(days) else ""))
        axes.locator_params(axis="y", nbins=5)
        axes.set_xlabel("month-day")
        return svg(figure, f"trend-{quantity.field}", f"{quantity.title}, by soak")


def _pooled_bounds(axes: Axes, trend: Trend) -> None:
    """Bounds of groups with several soaks, from their first to their last soak."""
    for number, group in enumerate(trend.groups):
        at = [k for k, run in enumerate(trend.runs) if run.group == number]
        if group.runs > 1 and group.draw_rate_upper is not None:
            axes.hlines(group.draw_rate_upper, at[0] - 0.4, at[-1] + 0.4, colors=SOFT, linewidth=1.4)
