"""Metrics of one trial of the ablation."""

from dataclasses import dataclass

import numpy as np

from eval.bench.trial import Trial
from eval.judge.monitors import MONITORS
from robots.arrays import Floats, Ints

JERK_ORDER = 3
"""Order of the backward difference of an angle."""
COLUMNS = {
    "goals": "goals, %",
    "running": "running, %",
    "stops": "stops per h",
    "hard_events": "hard events per h",
    "jerk": "jerk, rad/s³",
    "tracking_error": "tracking error, mrad",
    "winding": "hottest winding, °C",
    "copper_loss": "copper loss, W",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialMetrics:
    """Metrics of one variant; each number is a column of the table.

    Attributes:
        goals: % of those due, by ground truth. running: % of the time.
        stops, hard_events: per robot-hour; hard events of any monitor. hard_monitors: names and counts of those.
        jerk: rad/s³, RMS of the 3rd backward difference of the motors' angles at the joint, while powered.
        tracking_error: mrad, RMS of link angle minus sent angle, while powered.
        winding: °C, the hottest of all. copper_loss: W, mean over all joints.
    """

    goals: float
    running: float
    stops: float
    hard_events: float
    hard_monitors: str
    jerk: float
    tracking_error: float
    winding: float
    copper_loss: float


class MetricsRecorder:
    """Sums over the ticks of a trial, from which its metrics follow."""

    def __init__(self, trial: Trial) -> None:
        shape = trial.robot.robots, trial.runtime.spec.n
        self._trial, self._last = trial, np.zeros((JERK_ORDER, *shape))
        self._powered_run, self._ticks = np.zeros(shape[0], dtype=np.int64), 0
        self._jerk, self._tracking_error, self._copper_loss = np.zeros((3, *shape))
        self._jerk_ticks, self._powered_ticks = np.zeros((2, shape[0]), dtype=np.int64)
        self._winding = -np.inf

    def record(self) -> None:
        """Add the tick that has just ended."""
        robot, command = self._trial.robot, self._trial.runtime.command
        truth = robot.truth()
        powered = command.powered & truth.valid
        self._powered_run = np.where(powered, self._powered_run + 1, 0)
        differenced, difference = self._powered_run > JERK_ORDER, robot.plant.kinematics.motor_q.copy()
        for last in self._last:
            last[:], difference = difference, difference - last
        self._jerk[differenced] += difference[differenced] ** 2
        self._tracking_error[powered] += (truth.q - command.q)[powered] ** 2
        self._jerk_ticks += differenced
        self._powered_ticks += powered
        self._copper_loss += self._trial.copper_loss()
        self._winding, self._ticks = max(self._winding, truth.winding_c[truth.valid].max()), self._ticks + 1

    def metrics(self) -> TrialMetrics:
        """Return the metrics of the ticks so far."""
        counts, dt = self._trial.judge.counts(), self._trial.runtime.spec.dt
        hard = {monitor.name: counts.total(monitor.name) for monitor in MONITORS if monitor.hard}
        return TrialMetrics(
            goals=100 * counts.goal_success,
            running=100 * counts.availability,
            stops=counts.stops.sum() / counts.hours,
            hard_events=sum(hard.values()) / counts.hours,
            hard_monitors=", ".join(f"{name} {events}" for name, events in hard.items() if events),
            jerk=_rms(self._jerk, self._jerk_ticks) / dt**JERK_ORDER,
            tracking_error=1e3 * _rms(self._tracking_error, self._powered_ticks),
            winding=self._winding,
            copper_loss=self._copper_loss.mean() / self._ticks,
        )


def _rms(squares: Floats, ticks: Ints) -> float:
    """RMS over all joints, from sums (B, n) over ticks (B,)."""
    return float(np.sqrt(squares.sum() / max(1, ticks.sum() * squares.shape[1])))
