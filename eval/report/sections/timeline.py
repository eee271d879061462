"""The night on paper: for each robot, when it was hit, in steps of the night as wide as a mark that can be seen."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from eval.report.schema.rows import EventRow, RobotRow
from robots.arrays import Floats

Span = tuple[int, float, float]
"""A robot, and from when to when, h."""

STEPS = 240
"""Of the night: 8 hours in steps of 2 minutes. It bounds the size of the picture whatever happened."""


class Timeline(NamedTuple):
    """Bars (N, 3) of robot, begin and end, h, of each kind; bars of a robot and a kind do not meet.

    Attributes:
        lived: judged hours. lost: with a diverged simulation. unlisted: when some events were counted only.
        soft, hard: events. stops: when a robot left its work. latches: when it lost its power.
    """

    lived: Floats
    lost: Floats
    unlisted: Floats
    soft: Floats
    hard: Floats
    stops: Floats
    latches: Floats


def timeline(robots: Sequence[RobotRow], events: Sequence[EventRow], end_h: float) -> Timeline:
    """Bars from 0 to `end_h`, h."""
    step, many = end_h / STEPS, len(robots)

    def marked(spans: Iterable[Span]) -> Floats:
        return bars(np.array(list(spans), dtype=float).reshape(-1, 3), many, step)

    def happened(hard: bool) -> Floats:
        found = (e for e in events if e.hard == hard)
        return marked((e.robot, e.start_h, e.start_h + e.length_s / 3600) for e in found)

    unlisted = [(r.robot, r.unlisted_h, r.judged_hours) for r in robots if r.unlisted_h is not None]
    return Timeline(
        lived=_plain((r.robot, 0.0, r.judged_hours) for r in robots),
        lost=_plain((r.robot, r.judged_hours, r.hours) for r in robots if r.judged_hours < r.hours),
        unlisted=_plain(unlisted),
        soft=happened(False),
        hard=happened(True),
        stops=marked((r.robot, h - step / 2, h - step / 2) for r in robots for h in r.stopped_h),
        latches=marked((r.robot, h - step / 2, h - step / 2) for r in robots for h in r.latched_h),
    )


def bars(spans: Floats, robots: int, step_h: float) -> Floats:
    """Every step that a span (N, 3) touches, steps in a row as one bar (M, 3), by robot and time."""
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
