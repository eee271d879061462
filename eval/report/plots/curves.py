"""Plots over time: heat, wear and goals."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np

from eval.report.plots.canvas import COOL, HARD, SOFT, STYLE, WARM, canvas, curves, limit_line, svg
from eval.report.schema.report_data import GoalBin, Heat, Wear

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
