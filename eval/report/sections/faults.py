"""Section "faults": responses to injected faults by class."""

from collections.abc import Collection

import numpy as np

from eval.faults.catalogue import catalogue, not_injected
from eval.faults.fault_class import CATEGORY_NAMES, JOINT, POLICY, FaultClass, StopCategory
from eval.faults.fault_response import DIVERGED, NOT_RUNNING, FaultResponses
from eval.faults.schedule import FaultSettings
from eval.judge.monitors import MONITORS
from eval.report.schema.fault_rows import FaultRow, FaultTable, Times, UnhandledFault
from eval.statistics.budget import BudgetLine, budget_line
from eval.statistics.evidence import share_lower, trials_needed
from eval.statistics.numbers import number
from robots.arrays import Bools, Floats, Ints
from robots.sensors import AT_JOINTS, Kind
from robots.spec import RobotSpec

UNHANDLED_LISTED = 500
_HARD_BITS = {k: monitor.name for k, monitor in enumerate(MONITORS) if monitor.hard} | {DIVERGED: "diverged"}


def fault_table(
    spec: RobotSpec, read: Collection[Kind], settings: FaultSettings, found: FaultResponses
) -> FaultTable:
    """Return every fault class that the settings inject, whether or not it came up, and the first unhandled faults.

    `read` are the sensors that the runtime reads with this policy.
    """
    classes = catalogue(spec, read)
    required = np.array([each.answer for each in classes])[found.class_index]
    finished = found.complete >= 0
    handled = finished & (found.violated == 0) & (found.answer <= required)
    unhandled = np.argwhere(finished & ~handled)[:UNHANDLED_LISTED].tolist()
    return FaultTable(
        coverage=settings.coverage,
        injections=int(finished.sum()),
        rows=tuple(
            _row(spec, found, each, found.class_index == k, handled)
            for k, each in enumerate(classes)
            if settings.injects(each)
        ),
        unhandled=tuple(_unhandled(spec, classes, found, (robot, slot)) for robot, slot in unhandled),
        not_injected=(*_left_out(classes, settings), *not_injected(spec, read)),
    )


def _left_out(classes: tuple[FaultClass, ...], settings: FaultSettings) -> tuple[str, ...]:
    count = sum(not settings.injects(each) for each in classes)
    return (f"{count} of {len(classes)} classes, which the profile leaves out.",) if count else ()


def fault_line(table: FaultTable) -> BudgetLine:
    """Return the budget line: the least share of any class that is shown to be handled."""
    worst = min(table.rows, key=lambda row: row.handled_lower)
    bounds, about = (table.coverage, worst.handled_lower), _about(worst, table.coverage)
    return budget_line("fault_coverage", *bounds, "share", at_least=True, about=about)


def _about(row: FaultRow, coverage: float) -> str:
    """Injections and handled ones of a class, and the number of injections needed if there were too few."""
    unhandled = row.injections - row.handled
    needed = trials_needed(coverage, unhandled)
    found = f"lowest bound: {row.where} {row.what}, {row.handled:,} of {row.injections:,} handled"
    if needed <= row.injections:
        return found
    condition = f"with {unhandled:,} unhandled, " if unhandled else ""
    return f"{found}; {condition}{100 * coverage:g} % needs {needed:,} injections"


def _row(
    spec: RobotSpec, found: FaultResponses, each: FaultClass, members: Bools, handled: Bools
) -> FaultRow:
    finished, dt = members & (found.complete >= 0), spec.dt
    total, good = int(finished.sum()), int((finished & handled).sum())
    answers, bits = found.answer[finished], found.violated[finished]
    return FaultRow(
        where=each.component,
        what=each.failure_mode,
        meaning=each.meaning,
        required=CATEGORY_NAMES[each.answer],
        injections=total,
        not_running=int((members & (found.began == NOT_RUNNING)).sum()),
        handled=good,
        handled_lower=float(share_lower(good, total)) if total else 0.0,
        answers={word: n for a, word in CATEGORY_NAMES.items() if (n := int(np.sum(answers == a)))},
        violations={name: n for k, name in _HARD_BITS.items() if (n := int(np.sum(bits >> k & 1)))},
        stopped=_times(found.stopped[finished], dt),
        at_rest=_times(found.rest[finished], dt),
        resumed=int(np.sum(found.resumed[finished] >= 0)),
        deviation_rad=_worst(found.tracking_error[finished]),
        load=_worst(found.limit_ratio[finished]),
    )


def _times(ticks: Ints, dt: float) -> Times | None:
    seconds = ticks[ticks >= 0] * dt
    if not len(seconds):
        return None
    median, worst = (round(float(value), 4) for value in (np.median(seconds), seconds.max()))
    return Times(count=len(seconds), median_s=median, worst_s=worst)


def _worst(values: Floats) -> float | None:
    return number(float(values.max()), 4) if len(values) else None


def _unhandled(
    spec: RobotSpec, classes: tuple[FaultClass, ...], found: FaultResponses, place: tuple[int, int]
) -> UnhandledFault:
    fault, channel = classes[found.class_index[place]], int(found.channel[place])
    at_joint = fault.component in (*AT_JOINTS, POLICY, JOINT)
    return UnhandledFault(
        robot=place[0],
        fault=": ".join((fault.name, *_pair_names(classes, found.pair[place]))),
        channel=None if channel < 0 else spec.joint_names[channel] if at_joint else str(channel),
        start_h=round(float(found.began[place]) * spec.dt / 3600, 5),
        answer=CATEGORY_NAMES[StopCategory(found.answer[place])],
        violations=tuple(name for k, name in _HARD_BITS.items() if found.violated[place] >> k & 1),
        stopped_s=_seconds(int(found.stopped[place]), spec.dt),
        at_rest_s=_seconds(int(found.rest[place]), spec.dt),
        deviation_rad=number(float(found.tracking_error[place]), 4),
    )


def _pair_names(classes: tuple[FaultClass, ...], pair: Ints) -> tuple[str, ...]:
    """Return both faults of a pair as one text; nothing for another fault."""
    return (" + ".join(classes[k].name for k in pair),) if pair[0] >= 0 else ()


def _seconds(ticks: int, dt: float) -> float | None:
    return round(ticks * dt, 4) if ticks >= 0 else None
