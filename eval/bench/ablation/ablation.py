"""Ablation: the same draws and goals under the whole stack, and with one stage replaced.

The plant is that of the soak. The policy is the shipped one, trained with all stages.
"""

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from deploy.telemetry.output_files import replacing
from eval.bench.ablation.metrics import COLUMNS, MetricsRecorder, TrialMetrics
from eval.bench.ablation.stage_variants import VARIANTS, Variant
from eval.bench.trial import Trial
from robots.randomness import robot_seed
from robots.spec import RobotSpec

SEED, ROBOTS, TRIAL_S = 11, 64, 60.0
WHOLE_COLOUR, VARIANT_COLOUR, IDLE_COLOUR = "#1f5f8b", "#c9743a", "#e8cfbd"


def ablation(spec: RobotSpec, policy: Path, console: Console, picture: Path | None = None) -> None:
    """Print a row for each variant; draw `picture` if given."""
    metrics = {name: measure(spec, policy, variant) for name, variant in VARIANTS.items()}
    table = Table(
        *("", *COLUMNS.values()),
        title=f"{ROBOTS} robots x {TRIAL_S:g} s; draws, goals and noise are the same, one stage is replaced",
        caption="jerk of motors and error of links: RMS with power on, at rest too; copper loss: mean of all joints",
    )
    for name, row in metrics.items():
        cells = {field: _number(getattr(row, field)) for field in COLUMNS}
        cells["hard_events"] += f" ({row.hard_monitors})" if row.hard_monitors else ""
        table.add_row(name, *cells.values())
    console.print(table)
    if picture is not None:
        with replacing(picture) as file:
            draw_metrics(metrics, file)


def _number(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def measure(spec: RobotSpec, policy: Path, variant: Variant) -> TrialMetrics:
    """Run one trial with a variant of the stack."""
    trial = Trial(spec, policy, [robot_seed(SEED, robot) for robot in range(ROBOTS)])
    variant(trial.runtime)
    recorder = MetricsRecorder(trial)
    for _ in trial.advance(TRIAL_S):
        recorder.record()
    return recorder.metrics()


def draw_metrics(metrics: Mapping[str, TrialMetrics], file: Path) -> None:
    """Draw a panel for each column and a bar for each variant as a PNG, to be shown 800 px wide."""
    with mpl.rc_context({"font.size": 8.5, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(8.0, 3.6), dpi=200, facecolor="white", layout="constrained")
        figure.supxlabel("pale: the robot stands still for most of the time", fontsize=8.5)
        variants = list(metrics.values())[1:]
        colours = [WHOLE_COLOUR, *(VARIANT_COLOUR if row.running > 50 else IDLE_COLOUR for row in variants)]
        panels = figure.subplots(2, len(COLUMNS) // 2, sharey=True)
        for axes, (field, title) in zip(panels.flat, COLUMNS.items(), strict=True):
            axes.set_title(title, fontsize=8.5, loc="left")
            _draw_bars(axes, {name: getattr(row, field) for name, row in metrics.items()}, colours)
        panels[0, 0].invert_yaxis()
        figure.savefig(file, format="png")


def _draw_bars(axes: Axes, values: Mapping[str, float], colours: list[str]) -> None:
    bars = axes.barh(list(values), list(values.values()), color=colours, height=0.7)
    axes.bar_label(bars, [_number(value) for value in values.values()], padding=2)
    axes.set_xlim(0, 1.35 * max(values.values()) or 1.0)
    axes.set_xticks([])
    axes.spines["bottom"].set_visible(False)
    axes.tick_params(left=False)
