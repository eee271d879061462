"""Canvas of all plots: SVG text whose colours come from the page, so that it fits light, dark and print."""

import html
import io
import re
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from eval.statistics.numbers import Number
from robots.arrays import Floats

# Colours in matplotlib's output, and the page's colours that replace them.
INK, GRID, COOL, WARM, SOFT, HARD = "#010101", "#020202", "#030303", "#040404", "#050505", "#060606"
PAGE_COLOURS = {
    INK: "var(--muted)",
    GRID: "var(--line)",
    COOL: "var(--series-1)",
    WARM: "var(--series-2)",
    SOFT: "var(--warn)",
    HARD: "var(--bad)",
}
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


def canvas(width: float, height: float, left_in: float = 0.5) -> tuple[Figure, Axes]:
    """Return a figure, size in inches, and its axes, with room for tick labels and units on all sides."""
    # Left to itself, matplotlib imports its canvas late, and Ctrl-C in a C extension would become an ImportError.
    figure = FigureCanvasSVG(Figure(figsize=(width, height))).figure
    left, bottom, right = left_in / width, 0.42 / height, 0.24 / width
    axes = figure.add_axes((left, bottom, 1 - left - right, 1 - bottom - 0.05 / height))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    return figure, axes


def svg(figure: Figure, name: str, label: str) -> str:
    """Return SVG text with unique ids, the page's colours, and proportions instead of a size."""
    file, attributes = io.StringIO(), f'role="img" aria-label="{html.escape(label)}"'
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None})
    text = file.getvalue()[file.getvalue().index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    prefix = re.sub(r"\W", "-", name) + "-"
    text = re.sub(r'\bid="|url\(#|href="#', lambda found: found[0] + prefix, text)
    text = re.sub(
        r"<svg [^>]*?(viewBox=\"[^\"]*\")[^>]*>", lambda found: f"<svg {found[1]} {attributes}>", text
    )
    for colour, page_colour in PAGE_COLOURS.items():
        text = text.replace(colour, page_colour)
    return text


def limit_line(axes: Axes, value: float, colour: str, text: str, *, below: bool = False) -> None:
    """Draw a dashed horizontal line with its text above or below it."""
    axes.axhline(value, color=colour, linewidth=1.1, linestyle=(0, (4, 3)))
    offset, side = (-2, "top") if below else (2, "bottom")
    axes.annotate(
        text, (0, value), xytext=(4, offset), textcoords="offset points", va=side, color=colour, fontsize=8
    )


def curves(axes: Axes, hours: Sequence[float], median: Sequence[Number], extreme: Sequence[Number]) -> Floats:
    """Draw the extreme and above it the median; return both (2, T)."""
    lines = np.array((extreme, median), dtype=float)
    for line, colour in zip(lines, (WARM, COOL), strict=True):
        axes.plot(hours, line, color=colour, linewidth=1.4, marker="." if len(hours) < 2 else None)
    axes.set_xlim(0, max([*hours, 1e-3]))
    axes.set_xlabel("h")
    return lines
