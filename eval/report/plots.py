"""Plots as SVG text that takes its colours from the page: one picture serves light, dark and paper."""

import html
import io
import re
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from eval.report.data import GoalBin, Heat, Number, Wear

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
WEAR_SHOWN = {
    "friction": (100.0, 101.0),
    "backlash": (0.0, 0.1),
    "encoder error": (0.0, 0.1),
    "torque constant": (99.0, 100.0),
}
"""What the scale of each quantity's plot holds at least."""
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
        _limit(axes, 100 * wanted, SOFT, f"budget {100 * wanted:g} %", below=True)
        spread = 100 * np.maximum([share - low, high - share], 0.0)
        axes.errorbar(at, 100 * share, spread, fmt="o", color=COOL, markersize=4.5, elinewidth=1.4)
        axes.set_ylim(max(-1.0, 100 * low.min(initial=wanted) - 2), 100.5)
        axes.set_xlim(0, max([b.end_h for b in bins], default=1.0))
        axes.set_xlabel("h")
        axes.set_ylabel("% of goals")
        return _svg(figure, "goals", "Share of goals reached over time")


def _curves(
    axes: Axes, hours: Sequence[float], median: Sequence[Number], most: Sequence[Number]
) -> NDArray[np.float64]:
    """The extreme, and over it the median: both are returned."""
    lines = np.array((most, median), dtype=float)
    for line, colour in zip(lines, (WARM, COOL), strict=True):
        axes.plot(hours, line, color=colour, linewidth=1.4, marker="." if len(hours) < 2 else None)
    axes.set_xlim(0, max([*hours, 1e-3]))
    axes.set_xlabel("h")
    return lines


def _canvas(width: float, height: float) -> tuple[Figure, Axes]:
    """A figure of some inches and its axes, with room for tick labels and units."""
    figure = Figure(figsize=(width, height))
    left, bottom, right = 0.5 / width, 0.42 / height, 0.16 / width
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
