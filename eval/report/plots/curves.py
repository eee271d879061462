"""Plots over time: heat, wear and goals of one soak, and the trend over soaks."""

from collections.abc import Sequence
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MaxNLocator

from eval.report.plots.canvas import COOL, HARD, SOFT, STYLE, WARM, canvas, curves, limit_line, svg
from eval.report.schema.report_data import GoalBin, Heat, Wear
from eval.report.schema.trend_rows import Estimate, Trend

WEAR_SCALE = {
    "friction": (100.0, 101.0),
    "backlash": (0.0, 0.1),
    "encoder error": (0.0, 0.1),
    "torque constant": (99.0, 100.0),
}
"""Range that the scale of each plot includes at least, so that negligible changes look flat."""


def heat_plot(hours: Sequence[float], heat: Heat, top_c: float) -> str:
    """Return the plot of the winding temperature of one joint, up to `top_c` °C."""
    with mpl.rc_context(STYLE):
        figure, axes = canvas(3.3, 2.0)
        limit_line(axes, heat.max_c, HARD, f"hard {heat.max_c:g}")
        limit_line(axes, heat.soft_c, SOFT, f"soft {heat.soft_c:g}")
        hottest, median = curves(axes, hours, heat.median_c, heat.hottest_c)
        axes.fill_between(hours, median, hottest, color=WARM, alpha=0.15, linewidth=0)
        axes.set_ylim(bottom=min(20.0, np.nanmin(median, initial=20.0)), top=top_c)
        axes.set_ylabel("°C")
        return svg(figure, f"heat-{heat.joint}", f"Winding temperature of {heat.joint} over time")


def wear_plot(hours: Sequence[float], wear: Wear) -> str:
    """Return the plot of one quantity that wears."""
    with mpl.rc_context(STYLE):
        figure, axes = canvas(2.7, 1.8)
        axes.update_datalim([(0.0, bound) for bound in WEAR_SCALE[wear.name]])
        curves(axes, hours, wear.median, wear.most_worn)
        axes.locator_params(nbins=4)
        return svg(figure, f"wear-{wear.name}", f"{wear.name.capitalize()} over time")


def goals_plot(bins: Sequence[GoalBin], wanted: float) -> str:
    """Return the plot of the share of goals reached in each bin with its 95 % interval, and the budget's share."""
    with mpl.rc_context(STYLE):
        figure, axes = canvas(4.4, 2.3)
        used = [b for b in bins if b.attempted]
        at = np.array([(b.start_h + b.end_h) / 2 for b in used])
        share = np.array([b.reached / b.attempted for b in used])
        low, high = np.array([b.low for b in used]), np.array([b.high for b in used])
        limit_line(axes, 100 * wanted, SOFT, f"budget {100 * wanted:g} %", below=wanted > 0.1)
        spread = 100 * np.maximum([share - low, high - share], 0.0)
        axes.errorbar(at, 100 * share, spread, fmt="o", color=COOL, markersize=4.5, elinewidth=1.4)
        axes.set_ylim(max(-1.0, 100 * low.min(initial=wanted) - 2), 100.5)
        axes.set_xlim(0, max([b.end_h for b in bins], default=1.0))
        axes.set_xlabel("h")
        axes.set_ylabel("% of goals")
        return svg(figure, "goals", "Share of goals reached over time")


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
