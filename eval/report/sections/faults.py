"""From what became of injected faults to the rows of the report."""

from collections.abc import Iterator

import numpy as np

from eval.faults.catalogue import NOT_INJECTED, catalogue
from eval.faults.fault_class import ANSWER_WORDS, JOINT, POLICY, Answer, FaultClass
from eval.faults.fault_response import DIVERGED, NOT_RUNNING, FaultResponses
from eval.judge.monitors import MONITORS
from eval.report.schema.fault_rows import FaultRow, FaultTable, Miss, Times
from eval.report.schema.numbers import number
from eval.report.schema.report_data import Line
from eval.soak.profile import Faults
from eval.statistics.evidence import share_lower, trials_needed
from robots.arrays import Bools, Floats, Ints
from robots.sensors import AT_JOINTS
from robots.spec import RobotSpec

MISSES_LISTED = 500
_HURT = {k: monitor.name for k, monitor in enumerate(MONITORS) if monitor.hard} | {DIVERGED: "diverged"}


def fault_table(spec: RobotSpec, asked: Faults, found: FaultResponses) -> FaultTable:
    """Every class of the catalogue, injected or not, and the first faults that were not handled."""
    classes = catalogue(spec)
    most = np.array([each.answer for each in classes])[found.class_index]
    told = found.complete >= 0
    handled = told & (found.violated == 0) & (found.answer <= most)
    missed = np.argwhere(told & ~handled)[:MISSES_LISTED].tolist()
    return FaultTable(
        coverage=asked.coverage,
        injections=int(told.sum()),
        rows=tuple(
            _row(spec, found, each, found.class_index == k, handled) for k, each in enumerate(classes)
        ),
        misses=tuple(_miss(spec, classes, found, (robot, slot)) for robot, slot in missed),
        not_injected=NOT_INJECTED,
    )


def fault_line(table: FaultTable) -> Line:
    """The budget line: of every class at least so many are shown to be handled."""
    worst = min(table.rows, key=lambda row: row.handled_lower)
    return Line(
        name="fault_coverage",
        unit="share",
        at_least=True,
        allowed=table.coverage,
        found=worst.handled_lower,
        passed=worst.handled_lower >= table.coverage,
        about=_about(worst, table.coverage),
    )


def _about(row: FaultRow, coverage: float) -> str:
    """How often a class was handled, and how often it must be injected for that to be enough, if it was not."""
    missed = row.injections - row.handled
    needed = trials_needed(coverage, missed)
    told = f"least sure: {row.where} {row.what}, {row.handled:,} of {row.injections:,} handled"
    if needed <= row.injections:
        return told
    given = f"with {missed:,} missed, " if missed else ""
    return f"{told}; {given}{100 * coverage:g} % takes {needed:,} injections"


def _row(spec: RobotSpec, found: FaultResponses, each: FaultClass, mine: Bools, handled: Bools) -> FaultRow:
    told, dt = mine & (found.complete >= 0), spec.dt
    many, well = int(told.sum()), int((told & handled).sum())
    answers, hurt = found.answer[told], found.violated[told]
    return FaultRow(
        where=each.where,
        what=each.what,
        meaning=each.meaning,
        asked=ANSWER_WORDS[each.answer],
        injections=many,
        not_at_work=int((mine & (found.began == NOT_RUNNING)).sum()),
        handled=well,
        handled_lower=float(share_lower(well, many)) if many else 0.0,
        answers={
            ANSWER_WORDS[answer]: int(np.sum(answers == answer)) for answer in Answer if answer in answers
        },
        hurt={name: int(np.sum(hurt >> k & 1)) for k, name in _HURT.items() if np.any(hurt >> k & 1)},
        left=_times(found.stopped[told], dt),
        rest=_times(found.rest[told], dt),
        again=int(np.sum(found.resumed[told] >= 0)),
        astray_rad=_worst(found.tracking_error[told]),
        load=_worst(found.limit_ratio[told]),
    )


def _times(ticks: Ints, dt: float) -> Times | None:
    seconds = ticks[ticks >= 0] * dt
    if not len(seconds):
        return None
    return Times(
        many=len(seconds),
        median_s=round(float(np.median(seconds)), 4),
        worst_s=round(float(seconds.max()), 4),
    )


def _worst(values: Floats) -> float | None:
    return number(float(values.max()), 4) if len(values) else None


def _miss(
    spec: RobotSpec, classes: tuple[FaultClass, ...], found: FaultResponses, place: tuple[int, int]
) -> Miss:
    fault, channel = classes[found.class_index[place]], int(found.channel[place])
    return Miss(
        robot=place[0],
        fault=fault.name,
        channel=None if channel < 0 else _channel(spec, fault, channel),
        start_h=round(float(found.began[place]) * spec.dt / 3600, 5),
        answer=ANSWER_WORDS[Answer(found.answer[place])],
        hurt=tuple(_hurt(int(found.violated[place]))),
        left_s=_since(int(found.stopped[place]), spec.dt),
        rest_s=_since(int(found.rest[place]), spec.dt),
        astray_rad=number(float(found.tracking_error[place]), 4),
    )


def _hurt(bits: int) -> Iterator[str]:
    return (name for k, name in _HURT.items() if bits >> k & 1)


def _channel(spec: RobotSpec, fault: FaultClass, channel: int) -> str:
    return spec.joint_names[channel] if fault.where in (*AT_JOINTS, POLICY, JOINT) else str(channel)


def _since(ticks: int, dt: float) -> float | None:
    return round(ticks * dt, 4) if ticks >= 0 else None
