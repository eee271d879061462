"""What robots did about the faults that befell them, from ground truth, and whether that was right.

A fault is handled if from its begin until the robot is at work again no hard monitor of the judge says anything, and
if the robot's answer is the one that its class asks for, or a gentler one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from deploy.backends.sim.truth import Truth
from deploy.masks import any_true
from deploy.stage import Stage
from deploy.state import Command, Mode
from eval.faults.faults import Answer
from eval.faults.schedule import Injection, Schedule
from eval.judge.judge import Judge
from eval.judge.monitors import MONITORS
from robots.arrays import Bools, Floats, Ints
from robots.spec import RobotSpec

SETTLE_S = 0.5
"""s that a robot must have been at work after a fault is over for its story to be over too."""
RESTS = 0.05
"""rad/s below which a joint rests."""
NOT_YET, NOT_AT_WORK = -1, -2
"""In the place of the tick of an injection that has not begun, or that found its robot not at work: it counts not."""
HARD = tuple(k for k, monitor in enumerate(MONITORS) if monitor.hard)
DIVERGED = len(MONITORS)
"""Bit of a simulation that diverged, beside those of the monitors, in their order."""

Modes = NDArray[np.integer]


@dataclass(frozen=True, slots=True, kw_only=True)
class Injections:
    """What became of S injections into each of R robots; ticks are since the injection began, -1 for never.

    Attributes:
        kind: (R, S) place in the catalogue. channel: (R, S), -1 for all.
        begun: (R, S) tick, or `NOT_YET` or `NOT_AT_WORK`. over: (R, S) when its story was.
        left: (R, S) when the robot left its work for the first time. rest: (R, S) when it then truly stood still.
        again: (R, S) when it was at work again after the fault's end.
        answer: (R, S) the most severe `Answer`.
        hurt: (R, S) bit set of hard monitors, in their order, that had something to say.
        astray: (R, S) rad, the farthest that a true angle was from the one sent, until it rested.
        load: (R, S) the largest share of the limits of angle and speed.
    """

    kind: Ints
    channel: Ints
    begun: Ints
    over: Ints
    left: Ints
    rest: Ints
    again: Ints
    answer: Ints
    hurt: Ints
    astray: Floats
    load: Floats


_NAMES = tuple(field.name for field in fields(Injections))


def injections(saved: Mapping[str, Any], robots: int) -> Injections:
    """Those of the first robots of a shard, as it was saved."""
    return Injections(**{name: saved[f"watch.{name}"][:robots] for name in _NAMES})


def merged(parts: Sequence[Injections]) -> Injections:
    """The robots of all parts, one after the other."""
    rows: dict[str, Any] = {n: np.concatenate([getattr(part, n) for part in parts]) for n in _NAMES}
    return Injections(**rows)


class Watch(Stage):
    """Follows each robot from a fault's begin until it is at work again, or until its slot is over.

    Attributes:
        slot: (B,) whose injection is being followed, -1 for none.
        before: (B, monitors + 1) bad ticks of each hard monitor when it began.
        ends, ending: (B,) ticks at which its fault is over, and its slot.
        speed: (B,) rad/s, sent in the last tick. powered: (B,) in the last tick.
    """

    carried: ClassVar[tuple[str, ...]] = (*_NAMES, "slot", "before", "speed", "powered", "ends", "ending")

    def __init__(self, spec: RobotSpec, schedule: Schedule) -> None:
        """Allocate."""
        self._schedule, shape = schedule, schedule.kind.shape
        self.kind, self.channel = schedule.kind.copy(), schedule.channel.copy()
        self.begun, self.over, self.left, self.rest, self.again = np.full((5, *shape), NOT_YET)
        self.answer, self.hurt = np.zeros((2, *shape), dtype=np.int64)
        self.astray, self.load = np.zeros((2, *shape))
        robots = shape[0]
        self.slot, self.ends, self.ending = np.full((3, robots), -1)
        self.before = np.zeros((robots, len(MONITORS) + 1), dtype=np.int64)
        self.speed, self.powered = np.zeros(robots), np.zeros(robots, dtype=bool)
        low, high = spec.joint_array("q_min"), spec.joint_array("q_max")
        self._middle, self._half = (low + high) / 2, (high - low) / 2
        self._speed, self._settle = spec.joint_array("qd_max"), round(SETTLE_S / spec.dt)

    def begin(self, tick: int, mode: Modes, judge: Judge) -> None:
        """Open the stories of faults that begin now, before the tick is lived.

        Args:
            tick: now. mode: (B,) of `Mode`, since the last tick.
            judge: of all ticks so far.
        """
        starting = self._schedule.beginning(tick)
        if not starting:
            return
        bad = _bad_ticks(judge, len(self.slot))
        for each in starting:
            self._open(each, tick, mode)
            self.before[each.robot] = bad[each.robot]

    def _open(self, each: Injection, tick: int, mode: Modes) -> None:
        robot, at_work = each.robot, mode[each.robot] == Mode.RUNNING
        self.begun[robot, each.slot] = tick if at_work else NOT_AT_WORK
        self.slot[robot] = each.slot if at_work else -1
        self.ends[robot], self.ending[robot] = each.ends, each.over
        self.powered[robot], self.speed[robot] = True, 0.0

    @property
    def following(self) -> bool:
        """Whether any story is open."""
        return any_true(self.slot >= 0)

    def step(self, tick: int, truth: Truth, command: Command, mode: Modes, judge: Judge) -> None:
        """Follow the stories that are open through the tick that has just been lived."""
        rows = np.flatnonzero(self.slot >= 0)
        place, now = (rows, self.slot[rows]), mode[rows]
        since = tick - self.begun[place]
        qd = truth.qd[rows]
        self._measure(place, truth.q[rows], qd, command.q[rows])
        self._answer(place, now, command)
        working, still = now == Mode.RUNNING, (np.abs(qd) < RESTS).all(axis=1)
        resting = ~working & (now != Mode.STOPPING) & (now != Mode.ARMING) & still
        _note(self.left, place, since, ~working)
        _note(self.rest, place, since, resting & (self.left[place] >= 0))
        after = tick - self.ends[rows]
        self.again[place] = np.where(working & (after >= 0), self.again[place], NOT_YET)
        _note(self.again, place, after, working & (after >= 0))
        settled = working & (after >= 0) & (after - self.again[place] >= self._settle)
        self._close(rows[settled | (tick >= self.ending[rows])], tick, judge)

    def _measure(self, place: tuple[Ints, Ints], q: Floats, qd: Floats, sent: Floats) -> None:
        """How far a joint is from where it was sent, until it rests, and how near to its limits."""
        moving = self.rest[place] < 0
        astray = np.where(moving, np.abs(q - sent).max(axis=1), 0.0)
        load = np.maximum(np.abs(q - self._middle) / self._half, np.abs(qd) / self._speed).max(axis=1)
        self.astray[place] = np.maximum(self.astray[place], astray)
        self.load[place] = np.maximum(self.load[place], load)

    def _answer(self, place: tuple[Ints, Ints], now: Modes, command: Command) -> None:
        """Power that goes while the robot is still sent along is category 0."""
        rows = place[0]
        powered = command.powered[rows]
        cut = self.powered[rows] & ~powered & (self.speed[rows] > RESTS)
        answer = np.select(
            (cut, now == Mode.LATCHED, (now == Mode.STOPPING) | (now == Mode.HOLDING)),
            (Answer.CUT, Answer.STOPPED, Answer.HELD),
            Answer.WENT_ON,
        )
        self.answer[place] = np.maximum(self.answer[place], answer)
        self.powered[rows], self.speed[rows] = powered, np.abs(command.qd[rows]).max(axis=1)

    def _close(self, rows: Ints, tick: int, judge: Judge) -> None:
        if not len(rows):
            return
        place = rows, self.slot[rows]
        hurt = (_bad_ticks(judge, len(self.slot)) > self.before)[rows]
        self.hurt[place] = (hurt << np.arange(hurt.shape[1])).sum(axis=1)
        self.over[place], self.slot[rows] = tick - self.begun[place], -1


def _note(when: Ints, place: tuple[Ints, Ints], tick: Ints, holds: Bools) -> None:
    """Write down the first tick at which something holds."""
    when[place] = np.where(holds & (when[place] < 0), tick, when[place])


def _bad_ticks(judge: Judge, robots: int) -> Ints:
    """(B, monitors + 1) bad ticks so far of each hard monitor, and unjudged ones; 0 of robots that do not count."""
    counts = judge.counts()
    bad = np.zeros((robots, len(MONITORS) + 1), dtype=np.int64)
    for k in HARD:
        bad[: counts.robots, k] = counts.bad_ticks[:, counts.columns(MONITORS[k].name)].sum(axis=1)
    bad[: counts.robots, DIVERGED] = counts.invalid
    return bad
