"""What each stage of the stack is worth: the same robots at the same goals, with all of it and with one stage swapped.

The plant is the one that soaks, the policy the one that ships, trained with all stages. What a stage is swapped for is
below, and is all that a robot has that lacks it; every other stage, safety among them, does what it always does.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from deploy.estimation.estimator import Estimator
from deploy.estimation.winding_observer import WindingObserver
from deploy.motion.smoother import Smoother
from deploy.runtime import Runtime
from deploy.state import Sample, Setpoint, State
from deploy.telemetry.output_files import replacing
from eval.bench.trial import Trial
from eval.judge.monitors import MONITORS
from robots.arrays import Bools, Floats
from robots.randomness import robot_seed
from robots.spec import RobotSpec

SEED, ROBOTS, LIVED_S = 11, 64, 60.0
JERK = 3
"""Order of the backward difference of an angle."""
WHOLE, SWAPPED, IDLE = "#1f5f8b", "#c9743a", "#e8cfbd"


class Newest(Estimator):
    """No filter: the newest packet as it is, and the difference of the last two over the time between their stamps.

    Ages, faults and heat stay the estimator's.
    """

    carried = (*Estimator.carried, "t_last", "q_last", "qd_last")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Nothing has arrived."""
        super().__init__(spec, robots)
        self.t_last = np.full((robots, 1), -np.inf)
        self.q_last, self.qd_last = np.zeros((2, robots, spec.n))

    def step(self, t: float, sample: Sample, sent: Setpoint) -> State:
        """What was heard, for what is."""
        state, packet = super().step(t, sample, sent), sample["encoder"]
        taken = packet.t[:, None]
        new = taken > self.t_last
        np.divide(packet.value - self.q_last, taken - self.t_last, out=self.qd_last, where=new)
        np.copyto(self.q_last, packet.value, where=new)
        np.copyto(self.t_last, taken, where=new)
        return state._replace(q=self.q_last, qd=self.qd_last)


class Late(Estimator):
    """No compensation of delays: what is believed of the time of the newest sample is taken for now."""

    def step(self, t: float, sample: Sample, sent: Setpoint) -> State:
        """What was, for what is."""
        state = super().step(t, sample, sent)
        history, belief = self.setpoints, self.joints
        whole = np.rint(belief.t_sample / self.dt)
        robots, joints = np.ogrid[: len(whole), : whole.shape[1]]
        place = whole.astype(np.int64) % history.depth
        q, qd = history.ring[robots, place, joints], history.ring[robots, place, joints + whole.shape[1]]
        return state._replace(q=q + qd * (belief.t_sample - whole * self.dt) + belief.e, qd=qd + belief.ed)


class Unsmoothed(Smoother):
    """No limits: what the policy wants is sent, and a stop is to stay there. Derivatives are differences of that."""

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """At rest."""
        super().__init__(spec, robots)
        self._dt = spec.dt

    def next(self, q_target: Floats, stopping: Bools) -> Setpoint:
        """The target, clamped as the smoother clamps it."""
        q = np.where(stopping[:, None], self.q, np.minimum(np.maximum(q_target, self.q_min), self.q_max))
        qd = (q - self.q) / self._dt
        return Setpoint(q=q, qd=qd, qdd=(qd - self.qd) / self._dt)

    def brake(self, start: Setpoint) -> tuple[Setpoint, Floats, Floats]:
        """Rest at once."""
        rest = Setpoint(q=start.q, qd=np.zeros_like(start.qd), qdd=-start.qd / self._dt)
        return rest, start.q, start.q


class Unguarded(WindingObserver):
    """Windings are taken to be as warm as their housings: nothing is folded back or stopped for them."""

    def step(self, t: float, sample: Sample) -> None:
        """Housings, as they are heard."""
        self.winding[:] = self.hottest[:] = sample["temperature"].value


def _newest(runtime: Runtime) -> None:
    runtime.estimator = Newest(runtime.spec, runtime.robot.robots)


def _late(runtime: Runtime) -> None:
    runtime.estimator = Late(runtime.spec, runtime.robot.robots)


def _unsmoothed(runtime: Runtime) -> None:
    runtime.smoother = Unsmoothed(runtime.spec, runtime.robot.robots)


def _unguarded(runtime: Runtime) -> None:
    runtime.estimator.windings = Unguarded(runtime.spec, runtime.robot.robots)


def _whole(runtime: Runtime) -> None:
    """Leave all as it is."""


VARIANTS: dict[str, Callable[[Runtime], None]] = {
    "whole stack": _whole,
    "no estimator": _newest,
    "delays left in": _late,
    "no smoother": _unsmoothed,
    "no heat guard": _unguarded,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Worth:
    """What a variant did, each a figure of its own column.

    Attributes:
        goals: % of those due, by ground truth. running: % of the time.
        stops, hard: per hour of a robot, hard events of any monitor; which: those monitors.
        jerk: rad/s³, RMS of the 3rd backward difference of the motors' angles at the joint, while powered.
        tracking: mrad, RMS of the links' angles away from those sent, while powered.
        winding: °C, the hottest of all. copper: W, mean over all joints.
    """

    goals: float
    running: float
    stops: float
    hard: float
    which: str
    jerk: float
    tracking: float
    winding: float
    copper: float


COLUMNS = {
    "goals": "goals, %",
    "running": "under way, %",
    "stops": "stops per h",
    "hard": "hard events per h",
    "jerk": "jerk, rad/s³",
    "tracking": "tracking, mrad",
    "winding": "hottest winding, °C",
    "copper": "copper loss, W",
}


class Measured:
    """Sums over the ticks of a trial."""

    def __init__(self, trial: Trial) -> None:
        """Nothing has happened."""
        shape = trial.robot.robots, trial.runtime.spec.n
        self._trial, self._last = trial, np.zeros((JERK, *shape))
        self._whole, self._ticks = np.zeros(shape[0], dtype=np.int64), 0
        self._jerk, self._tracking, self._copper = np.zeros((3, *shape))
        self._jerks, self._live = np.zeros((2, shape[0]), dtype=np.int64)
        self._hottest = -np.inf

    def look(self) -> None:
        """Add the tick that has just ended."""
        robot, command = self._trial.robot, self._trial.runtime.command
        truth = robot.truth()
        live = command.powered & truth.valid
        self._whole = np.where(live, self._whole + 1, 0)
        whole, difference = self._whole > JERK, robot.plant.kinematics.motor_q.copy()
        for last in self._last:
            last[:], difference = difference, difference - last
        self._jerk[whole] += difference[whole] ** 2
        self._tracking[live] += (truth.q - command.q)[live] ** 2
        self._jerks += whole
        self._live += live
        self._copper += self._trial.copper_w()
        self._hottest, self._ticks = max(self._hottest, truth.winding_c[truth.valid].max()), self._ticks + 1

    def worth(self) -> Worth:
        """The figures."""
        counts, dt = self._trial.judge.counts(), self._trial.runtime.spec.dt
        hard = {monitor.name: counts.total(monitor.name) for monitor in MONITORS if monitor.hard}
        return Worth(
            goals=100 * counts.goal_success,
            running=100 * counts.availability,
            stops=counts.stops.sum() / counts.hours,
            hard=sum(hard.values()) / counts.hours,
            which=", ".join(f"{name} {many}" for name, many in hard.items() if many),
            jerk=_rms(self._jerk, self._jerks) / dt**JERK,
            tracking=1e3 * _rms(self._tracking, self._live),
            winding=self._hottest,
            copper=self._copper.mean() / self._ticks,
        )


def _rms(squares: Floats, ticks: NDArray[np.int64]) -> float:
    """Over all joints, of sums (B, n) over ticks (B,)."""
    return float(np.sqrt(squares.sum() / max(1, ticks.sum() * squares.shape[1])))


def ablation(spec: RobotSpec, policy: Path, console: Console, picture: Path | None = None) -> None:
    """A row for each variant, and a picture of them where one is asked for."""
    found = {name: measure(spec, policy, swap) for name, swap in VARIANTS.items()}
    table = Table(
        *("", *COLUMNS.values()),
        title=f"{ROBOTS} robots x {LIVED_S:g} s, the same draws, goals and noise for all; one stage swapped",
        caption="jerk of motors and error of links: RMS with power on, at rest too; copper loss: mean of all joints",
    )
    for name, worth in found.items():
        cells = {field: _figure(getattr(worth, field)) for field in COLUMNS}
        cells["hard"] += f" ({worth.which})" if worth.which else ""
        table.add_row(name, *cells.values())
    console.print(table)
    if picture is not None:
        with replacing(picture) as file:
            draw_worth(found, file)


def _figure(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def measure(spec: RobotSpec, policy: Path, swap: Callable[[Runtime], None]) -> Worth:
    """Live through the trial with one stage swapped."""
    trial = Trial(spec, policy, [robot_seed(SEED, robot) for robot in range(ROBOTS)])
    swap(trial.runtime)
    measured = Measured(trial)
    for _ in trial.live(LIVED_S):
        measured.look()
    return measured.worth()


def draw_worth(found: Mapping[str, Worth], file: Path) -> None:
    """A panel for each column, a bar for each variant; PNG, made to be shown 800 px wide."""
    with mpl.rc_context({"font.size": 8.5, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(8.0, 3.6), dpi=200, facecolor="white", layout="constrained")
        figure.supxlabel("pale: a robot that stands still most of the time", fontsize=8.5)
        colours = [WHOLE, *(SWAPPED if worth.running > 50 else IDLE for worth in list(found.values())[1:])]
        panels = figure.subplots(2, len(COLUMNS) // 2, sharey=True)
        for axes, (field, title) in zip(panels.flat, COLUMNS.items(), strict=True):
            values = [getattr(worth, field) for worth in found.values()]
            bars = axes.barh(list(found), values, color=colours, height=0.7)
            axes.bar_label(bars, [_figure(value) for value in values], padding=2)
            axes.set_title(title, fontsize=8.5, loc="left")
            axes.set_xlim(0, 1.35 * max(values) or 1.0)
            axes.set_xticks([])
            axes.spines["bottom"].set_visible(False)
            axes.tick_params(left=False)
        panels[0, 0].invert_yaxis()
        figure.savefig(file, format="png")
