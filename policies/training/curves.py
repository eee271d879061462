"""Plot of training curves from TensorBoard's events."""

from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

CURVES = {
    "Task/success": "goals reached",
    "Train/mean_reward": "reward per episode",
    "joint_limit_violations/requested": "joint limit violations per episode, requested",
    "joint_limit_violations/happened": "joint limit violations per episode, happened",
}


def draw_curves(events: Path, out: Path) -> None:
    """Plot the curves over iterations from the events in a folder."""
    log = EventAccumulator(str(events), size_guidance={"scalars": 0})
    log.Reload()
    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = FigureCanvasAgg(Figure(figsize=(9, 5), layout="constrained")).figure
        for axes, (tag, title) in zip(figure.subplots(2, 2).flat, CURVES.items(), strict=True):
            _curve(axes, log, tag, title)
        figure.savefig(out, dpi=120)


def _curve(axes: Axes, log: EventAccumulator, tag: str, title: str) -> None:
    # Of a short training some have no point: reward per episode, before one has ended.
    points = log.Scalars(tag) if tag in log.Tags()["scalars"] else []
    axes.plot([point.step for point in points], [point.value for point in points], linewidth=1.2)
    axes.set_title(title, loc="left", fontsize=9)
    axes.set_ylim(bottom=min([0.0, *(point.value for point in points)]))
    axes.grid(alpha=0.3)
