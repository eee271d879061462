"""Fault response: the answer of each robot to its injected faults, from ground truth.

A fault is handled if no hard monitor of the judge fires from its begin until the robot works again, and if the robot's
answer is not more severe than the expected one of its class.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from deploy.masks import any_true
from deploy.stage import Stage
from deploy.state import Command, Mode
from deploy.truth import Truth
from eval.faults.fault_class import Injection, StopCategory
from eval.faults.schedule import Schedule
from eval.judge.judge import Judge
from eval.judge.monitors import MONITORS
from robots.arrays import Bools, Floats, Ints
from robots.spec import RobotSpec

SETTLE_S = 0.5
"""Time in operation after the end of a fault until the response is complete, s."""
REST_RAD_S = 0.05
"""Speed below which a joint is at rest."""
NOT_BEGUN, NOT_RUNNING = -1, -2
"""In place of the tick of an injection that has not begun, or found its robot not in operation and does not count."""
HARD = tuple(k for k, monitor in enumerate(MONITORS) if monitor.hard)
DIVERGED = len(MONITORS)
"""Bit of a diverged simulation, after those of the monitors in the order of the catalogue."""

Modes = NDArray[np.integer]
Place = tuple[Ints, Ints]
"""Robots and slots."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultResponses:
    """Responses of R robots to the injections in S slots. Ticks count from the begin of the injection; -1 for never.

    Attributes:
        class_index: (R, S) place in the catalogue. channel: (R, S), -1 for all.
        pair: (R, S, 2) places of both faults of a pair, -1 for others.
        began: (R, S) tick of the soak, or `NOT_BEGUN` or `NOT_RUNNING`. complete: (R, S) end of the response.
        stopped: (R, S) first tick out of operation. rest: (R, S) first tick at rest by ground truth after that.
        resumed: (R, S) ticks from the end of the fault until the robot was in operation.
        answer: (R, S) the most severe `StopCategory`.
        violated: (R, S) bit set of the hard monitors that fired.
        tracking_error: (R, S) rad, largest distance of a true angle from the one sent, until rest.
        limit_ratio: (R, S) largest share of the limits of angle and speed.
    """

    class_index: Ints
    channel: Ints
    pair: Ints
    began: Ints
    complete: Ints
    stopped: Ints
    rest: Ints
    resumed: Ints
    answer: Ints
    violated: Ints
    tracking_error: Floats
    limit_ratio: Floats


_NAMES = tuple(field.name for field in fields(FaultResponses))


def saved_responses(saved: Mapping[str, Any], robots: int) -> FaultResponses:
    """Return those of the first robots of a `FaultResponseTracker`, as it was saved."""
    return FaultResponses(**{name: saved[name][:robots] for name in _NAMES})


def merge_responses(parts: Sequence[FaultResponses]) -> FaultResponses:
    """Return the robots of all parts, one after the other."""
    rows: dict[str, Any] = {n: np.concatenate([getattr(part, n) for part in parts]) for n in _NAMES}
    return FaultResponses(**rows)


class FaultResponseTracker(Stage):
    """Follows each robot from the begin of a fault until it works again, or until the end of its slot.

    Attributes:
        slot: (B,) slot of the injection that is followed, -1 for none.
        bad_before: (B, monitors + 1) bad ticks of each hard monitor when the injection began.
        fault_end, slot_end: (B,) ticks.
        speed: (B,) rad/s in the last tick, sent; of soft legs, which run from what is sent, that of the joints until
            they hold. powered: (B,) in the last tick.
    """

    carried: ClassVar[tuple[str, ...]] = (
        *(*_NAMES, "slot", "bad_before", "speed", "powered", "fault_end", "slot_end"),
    )

    def __init__(self, spec: RobotSpec, schedule: Schedule) -> None:
        self._schedule, shape = schedule, schedule.class_index.shape
        self.class_index, self.channel = schedule.class_index.copy(), schedule.channel.copy()
        self.pair = schedule.pair.copy()
        self.began, self.complete, self.stopped, self.rest, self.resumed = np.full((5, *shape), NOT_BEGUN)
        self.answer, self.violated = np.zeros((2, *shape), dtype=np.int64)
        self.tracking_error, self.limit_ratio = np.zeros((2, *shape))
        robots = shape[0]
        self.slot, self.fault_end, self.slot_end = np.full((3, robots), -1)
        self.bad_before = np.zeros((robots, len(MONITORS) + 1), dtype=np.int64)
        self.speed, self.powered = np.zeros(robots), np.zeros(robots, dtype=bool)
        low, high = spec.joint_array("q_min"), spec.joint_array("q_max")
        self._q_middle, self._q_half_range = np.mean(spec.pose_range, axis=0), (high - low) / 2
        self._soft = spec.base is not None
        self._qd_max, self._settle_ticks = spec.joint_array("qd_max"), round(SETTLE_S / spec.dt)

    def begin(self, tick: int, mode: Modes, judge: Judge) -> None:
        """Start to follow injections that begin at a tick, before that tick; `mode` (B,) is of the tick before."""
        injected = self._schedule.injected(tick)
        if not injected:
            return
        bad = _bad_ticks(judge, len(self.slot))
        for injection in injected:
            self._follow(injection, tick, mode)
            self.bad_before[injection.robot] = bad[injection.robot]

    def _follow(self, injection: Injection, tick: int, mode: Modes) -> None:
        robot, slot, running = injection.robot, injection.slot, mode[injection.robot] == Mode.RUNNING
        self.began[robot, slot] = tick if running else NOT_RUNNING
        self.slot[robot] = slot if running else -1
        self.fault_end[robot], self.slot_end[robot] = injection.ends, injection.slot_end
        self.powered[robot], self.speed[robot] = True, 0.0

    @property
    def following(self) -> bool:
        """Some injection is followed."""
        return any_true(self.slot >= 0)

    def step(self, tick: int, truth: Truth, command: Command, mode: Modes, judge: Judge) -> None:
        """Follow open injections through the tick that has just ended."""
        rows = np.flatnonzero(self.slot >= 0)
        place, now = (rows, self.slot[rows]), mode[rows]
        since = tick - self.began[place]
        qd = truth.qd[rows]
        self._measure(place, truth.q[rows], qd, command.q[rows])
        self._note_answer(place, now, command, qd)
        running, still = now == Mode.RUNNING, (np.abs(qd) < REST_RAD_S).all(axis=1)
        resting = ~running & (now != Mode.STOPPING) & (now != Mode.ARMING) & still
        _note_first(self.stopped, place, since, ~running)
        _note_first(self.rest, place, since, resting & (self.stopped[place] >= 0))
        after = tick - self.fault_end[rows]
        self.resumed[place] = np.where(running & (after >= 0), self.resumed[place], NOT_BEGUN)
        _note_first(self.resumed, place, after, running & (after >= 0))
        settled = running & (after >= 0) & (after - self.resumed[place] >= self._settle_ticks)
        self._close(rows[settled | (tick >= self.slot_end[rows])], tick, judge)

    def _measure(self, place: Place, q: Floats, qd: Floats, sent: Floats) -> None:
        """Update the largest tracking error, until rest, and the largest share of the limits."""
        moving = self.rest[place] < 0
        error = np.where(moving, np.abs(q - sent).max(axis=1), 0.0)
        ratio = np.maximum(np.abs(q - self._q_middle) / self._q_half_range, np.abs(qd) / self._qd_max)
        self.tracking_error[place] = np.maximum(self.tracking_error[place], error)
        self.limit_ratio[place] = np.maximum(self.limit_ratio[place], ratio.max(axis=1))

    def _note_answer(self, place: Place, now: Modes, command: Command, qd: Floats) -> None:
        """Update the most severe answer. Power loss during motion counts as a category 0 stop."""
        rows = place[0]
        powered = command.powered[rows]
        cut = self.powered[rows] & ~powered & (self.speed[rows] > REST_RAD_S)
        answer = np.select(
            (cut, now == Mode.LATCHED, (now == Mode.STOPPING) | (now == Mode.HOLDING)),
            (StopCategory.CATEGORY_0, StopCategory.CATEGORY_1, StopCategory.CATEGORY_2),
            StopCategory.NO_STOP,
        )
        self.answer[place] = np.maximum(self.answer[place], answer)
        speed = command.qd[rows]
        if self._soft:
            speed = np.where(((now == Mode.RUNNING) | (now == Mode.STOPPING))[:, None], qd, 0.0)
        self.powered[rows], self.speed[rows] = powered, np.abs(speed).max(axis=1)

    def _close(self, rows: Ints, tick: int, judge: Judge) -> None:
        if not len(rows):
            return
        place = rows, self.slot[rows]
        violated = (_bad_ticks(judge, len(self.slot)) > self.bad_before)[rows]
        self.violated[place] = (violated << np.arange(violated.shape[1])).sum(axis=1)
        self.complete[place], self.slot[rows] = tick - self.began[place], -1


def _note_first(ticks: Ints, place: Place, now: Ints, holds: Bools) -> None:
    ticks[place] = np.where(holds & (ticks[place] < 0), now, ticks[place])


def _bad_ticks(judge: Judge, robots: int) -> Ints:
    """(B, monitors + 1) bad ticks so far of each hard monitor, and invalid ticks; 0 of robots that do not count."""
    counts = judge.counts()
    bad = np.zeros((robots, len(MONITORS) + 1), dtype=np.int64)
    for k in HARD:
        bad[: counts.robots, k] = counts.bad_ticks[:, counts.columns(MONITORS[k].name)].sum(axis=1)
    bad[: counts.robots, DIVERGED] = counts.invalid
    return bad
