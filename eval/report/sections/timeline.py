"""Timeline of all robots: events and stops in steps wide enough to be seen in the plot."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from eval.report.schema.rows import EventRow, RobotRow
from robots.arrays import Floats

Span = tuple[int, float, float]
"""Robot, begin and end, h."""

STEPS = 240
"""Steps of the whole soak, such as 2 minutes of 8 hours; bounds the size of the plot."""


class Timeline(NamedTuple):
    """Bars (N, 3) of robot, begin and end, h, for each kind; bars of the same robot and kind do not touch.

    Attributes:
        judged: judged hours. diverged: with a diverged simulation. unlisted: when some events are not listed.
        soft, hard: events. stops: new stops. latches: power losses.
    """

    judged: Floats
    diverged: Floats
    unlisted: Floats
    soft: Floats
    hard: Floats
    stops: Floats
    latches: Floats


def timeline(robots: Sequence[RobotRow], events: Sequence[EventRow], end_h: float) -> Timeline:
    """Return the bars from 0 to `end_h`, h."""
    step = end_h / STEPS

    def stepped(spans: Iterable[Span]) -> Floats:
        return bars(np.array(list(spans), dtype=float).reshape(-1, 3), len(robots), step)

    def event_bars(hard: bool) -> Floats:
        found = (e for e in events if e.hard == hard)
        return stepped((e.robot, e.start_h, e.start_h + e.length_s / 3600) for e in found)

    unlisted = [(r.robot, r.unlisted_h, r.judged_hours) for r in robots if r.unlisted_h is not None]
    return Timeline(
        judged=_plain((r.robot, 0.0, r.judged_hours) for r in robots),
        diverged=_plain((r.robot, r.judged_hours, r.hours) for r in robots if r.judged_hours < r.hours),
        unlisted=_plain(unlisted),
        soft=event_bars(False),
        hard=event_bars(True),
        stops=stepped((r.robot, h - step / 2, h - step / 2) for r in robots for h in r.stopped_h),
        latches=stepped((r.robot, h - step / 2, h - step / 2) for r in robots for h in r.latched_h),
    )


def bars(spans: Floats, robots: int, step_h: float) -> Floats:
    """Return bars (M, 3) of all steps that spans (N, 3) touch, adjacent steps joined, by robot and time."""
    ends = np.zeros((robots, STEPS + 1), dtype=np.int64)
    first, last = (np.clip(spans[:, k] // step_h, 0, STEPS - 1).astype(np.int64) for k in (1, 2))
    robot = spans[:, 0].astype(np.int64)
    np.add.at(ends, (robot, first), 1)
    np.add.at(ends, (robot, last + 1), -1)
    touched = (ends.cumsum(axis=1) > 0).astype(np.int64)
    turns = np.diff(touched, axis=1, prepend=0)
    (row, begin), (_, end) = np.nonzero(turns > 0), np.nonzero(turns < 0)
    return np.stack((row, begin * step_h, end * step_h), axis=1)


def _plain(spans: Iterable[Span]) -> Floats:
    return np.array(list(spans), dtype=float).reshape(-1, 3)
