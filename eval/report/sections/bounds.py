"""Section "evidence": confidence bounds of hard events, all monitors together."""

import numpy as np

from eval.judge.counts import Counts
from eval.judge.monitors import MONITORS
from eval.report.schema.numbers import Number, number
from eval.report.schema.rows import Evidence, FurtherHours
from eval.report.sections.statement import dispersion_sentence, event_statement
from eval.statistics.dispersion import dispersion_p, draw_rate_interval, draw_rate_upper
from eval.statistics.evidence import (
    CONFIDENCE,
    family_confidence,
    further_hours,
    rate_interval,
    rate_upper,
    share_upper,
)
from robots.arrays import Floats

MTBF_WANTED_H = (100.0, 1000.0)


def evidence(counts: Counts) -> Evidence:
    """Return the bounds of hard events of all monitors together."""
    events, hours = counts.hard_events(), operating_hours(counts)
    total, exposure, bad = int(events.sum()), counts.running_hours, counts.bad_draws()
    p = dispersion_p(events, hours)
    return Evidence(
        confidence=CONFIDENCE,
        hard_events=total,
        hard_rate=total / exposure if exposure else None,
        hard_rate_upper=number(rate_upper(total, exposure)),
        hard_rate_interval=interval(rate_interval(total, exposure)),
        draw_rate_upper=number(draw_rate_upper(events, hours)),
        draw_rate_interval=interval(draw_rate_interval(events, hours)),
        bad_draws=bad,
        bad_draw_upper=float(share_upper(bad, counts.robots)),
        dispersion_p=p,
        dispersion=dispersion_sentence(p, total, counts.robots),
        family=len(hard_family(counts)),
        family_confidence=each_confidence(counts),
        further=tuple(_further(mtbf, total, exposure) for mtbf in MTBF_WANTED_H),
    )


def operating_hours(counts: Counts) -> Floats:
    """Return operating hours (R,) of each draw, the exposure of its rates."""
    return np.asarray(counts.running * counts.dt / 3600)


def hard_family(counts: Counts) -> list[str]:
    """Return the hard monitors with known limits, whose bounds shall hold at once."""
    return [m.name for m in MONITORS if m.hard and np.isfinite(counts.limits[counts.columns(m.name)]).all()]


def each_confidence(counts: Counts) -> float:
    """Return the confidence of the bound of one hard monitor, for all of them to hold at once with `CONFIDENCE`."""
    return family_confidence(max(1, len(hard_family(counts))))


def interval(ends: tuple[Floats, Floats]) -> tuple[Number, Number]:
    """Return both ends as numbers of report.json."""
    return number(ends[0]), number(ends[1])


def statement(counts: Counts, found: Evidence) -> str:
    """Return the first sentence of the report."""
    return event_statement(
        found.hard_events,
        counts.running_hours,
        f"{counts.robots} draws",
        (found.hard_rate_upper, found.draw_rate_upper, found.bad_draw_upper),
        (counts.availability, counts.goal_success),
    )


def _further(mtbf: float, events: int, hours: float) -> FurtherHours:
    return FurtherHours(
        mtbf_h=mtbf,
        hours=further_hours(mtbf, events, hours),
        same_rate_hours=further_hours(mtbf, 2 * events, hours),
    )
