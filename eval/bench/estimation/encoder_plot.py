"""Picture of one encoder of a simulated run: truth, packets and estimate."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.bench.estimation.recorded_motion import JointEstimates, Motion
from robots.arrays import Floats
from robots.spec import RobotSpec

WINDOW_S = 0.6
TRUTH, SAMPLES, ESTIMATE = "#222222", "#d9822b", "#2f6fb2"


def draw_encoder(spec: RobotSpec, motion: Motion, estimates: JointEstimates, file: Path) -> None:
    """Draw the fastest joint of all around its fastest moment as a PNG: angle, error of the angle, and speed."""
    ticks = round(WINDOW_S / spec.dt)
    inner = motion.qd[ticks:-ticks]
    tick, robot, joint = np.unravel_index(np.abs(inner).argmax(), inner.shape)
    window = slice(int(tick) + ticks // 2, int(tick) + ticks // 2 + ticks)
    t = np.arange(ticks, dtype=np.float64) * 1e3 * spec.dt
    q, qd, raw, differenced, q_hat, qd_hat = (
        values[window, robot, joint]
        for values in (
            *(motion.q, motion.qd),
            *(estimates.raw, estimates.differenced, estimates.q, estimates.qd),
        )
    )
    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(8, 6.4), layout="constrained")
        angle, error, speed = figure.subplots(3, 1, sharex=True)
        _draw_lines(angle, t, "angle, rad", q=q, raw=raw, estimate=q_hat)
        _draw_lines(error, t, "error of the angle, mrad", raw=1e3 * (raw - q), estimate=1e3 * (q_hat - q))
        _draw_lines(speed, t, "speed, rad/s", q=qd, raw=differenced, estimate=qd_hat)
        speed.set_xlabel("ms")
        angle.legend(loc="best", frameon=False)
        angle.set_title(
            f"{spec.joint_names[joint]} of one robot, as drawn: noise, late packets, lost ones", loc="left"
        )
        figure.savefig(file, dpi=110, format="png")


def _draw_lines(
    axes: Axes, t: Floats, label: str, *, raw: Floats, estimate: Floats, q: Floats | None = None
) -> None:
    packets = "latest packet (speed: difference of the last two)"
    axes.plot(t, raw, ".", color=SAMPLES, markersize=3.5, label=packets)
    if q is not None:
        axes.plot(t, q, color=TRUTH, linewidth=2.2, alpha=0.55, label="truth")
    axes.plot(t, estimate, color=ESTIMATE, linewidth=1.3, label="estimate")
    axes.set_ylabel(label)
    axes.grid(visible=True, color="#e4e4e4", linewidth=0.6)
