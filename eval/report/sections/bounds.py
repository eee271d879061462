"""How sure the counts allow us to be, and the sentence that they support."""

import numpy as np

from eval.judge.counts import Counts
from eval.judge.monitors import MONITORS
from eval.report.schema.numbers import Number, figure, number
from eval.report.schema.rows import Evidence, Further
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
    """Bounds on hard events of all monitors together."""
    events, hours = counts.hard_events(), hours_under_way(counts)
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
        dispersion=_dispersion(p, total, counts.robots),
        family=len(family(counts)),
        family_confidence=each_confidence(counts),
        further=tuple(_further(mtbf, total, exposure) for mtbf in MTBF_WANTED_H),
    )


def hours_under_way(counts: Counts) -> Floats:
    """(R,) h of each draw: the exposure of its rates."""
    return np.asarray(counts.running * counts.dt / 3600)


def family(counts: Counts) -> list[str]:
    """Hard monitors whose limits are known: all of them may fire, and one that does is one too many."""
    return [m.name for m in MONITORS if m.hard and np.isfinite(counts.limits[counts.columns(m.name)]).all()]


def each_confidence(counts: Counts) -> float:
    """Of the bound of one hard monitor, for those of all of them to hold at once with `CONFIDENCE`."""
    return family_confidence(max(1, len(family(counts))))


def interval(ends: tuple[Floats, Floats]) -> tuple[Number, Number]:
    """Two ends as report.json holds them."""
    return number(ends[0]), number(ends[1])


def statement(counts: Counts, found: Evidence) -> str:
    """The sentence that the run supports, and no other."""
    alike, differ, many = found.hard_rate_upper, found.draw_rate_upper, found.hard_events
    bound = f"rate ≤ {figure(alike, 2)} per hour" if alike is not None else "no bound on the rate"
    if differ is not None:
        bound += f" (≤ {figure(differ, 2)} where draws differ)"
    return (
        f"{many:,} hard event{'s' if many != 1 else ''} in {figure(counts.running_hours)} hours under way over"
        f" {counts.robots} draws: {bound}, P(bad draw) ≤ {found.bad_draw_upper:.2g} (each with"
        f" {100 * CONFIDENCE:.0f} %), availability {100 * counts.availability:.2f} %, goals reached"
        f" {100 * counts.goal_success:.2f} %."
    )


def _further(mtbf: float, events: int, hours: float) -> Further:
    return Further(
        mtbf_h=mtbf,
        hours=further_hours(mtbf, events, hours),
        alike_hours=further_hours(mtbf, 2 * events, hours),
    )


def _dispersion(p: float, events: int, draws: int) -> str:
    if events < 2:
        return "Whether draws differ cannot be told from fewer than two hard events."
    chance = f"chance alone spreads {events:,} hard events over {draws} draws as unevenly in {100 * p:.2g} % of nights"
    if p <= 1 - CONFIDENCE:
        return f"Draws differ: {chance}. Hours are not alike, and only the bound for draws that differ holds."
    return f"Draws were not shown to differ: {chance}. Few events cannot show it, so both bounds are given."
