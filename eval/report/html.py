"""report.html: one file, nothing loaded from elsewhere."""

from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from eval.report.data import Report
from eval.report.plots import goals_plot, heat_plot, wear_plot

TEMPLATE = Path(__file__).parent / "template.html"


def render(report: Report) -> str:
    """The page as text."""
    loader = FileSystemLoader(TEMPLATE.parent)
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"percent": percent, "figure": figure, "fixed": fixed}
    wanted = next(line.allowed for line in report.budget if line.name == "goal_success")
    top = max((line.max_c for line in report.heat), default=0.0)
    peak = max((c for line in report.heat for c in line.hottest_c if c is not None), default=0.0)
    return environment.get_template(TEMPLATE.name).render(
        r=report,
        heat=[Markup(heat_plot(report.sample_h, line, 1.08 * max(top, peak))) for line in report.heat],
        wear=[Markup(wear_plot(report.sample_h, line)) for line in report.wear],
        goals=Markup(goals_plot(report.goals.bins, wanted)),
        joints=[channel.joint for channel in report.monitors[0].channels],
        over=[line for line in report.budget if not line.passed],
    )


def percent(share: float | None, digits: int = 0) -> str:
    """A share as per cent, and `∞` for a number that is none."""
    return "∞" if share is None else f"{100 * share:.{digits}f} %"


def figure(value: float | None, digits: int = 3) -> str:
    """A number to some digits, thousands apart, and `–` for one that is none."""
    if value is None:
        return "–"
    return f"{value:,.0f}" if abs(value) >= 10**digits or value == int(value) else f"{value:.{digits}g}"


def fixed(value: float | None, unit: str) -> str:
    """A number to as many decimals as its unit is worth, and `–` for one that is none."""
    return "–" if value is None else f"{value:.{1 if unit == '%' else 2}f}"
