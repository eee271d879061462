"""Section "verdict": confidence bounds of hard events, all monitors together, and the statement that they support."""

import numpy as np

from eval.judge.counts import Counts
from eval.judge.monitors import MONITORS
from eval.report.schema.rows import Evidence, FurtherHours
from eval.statistics.dispersion import dispersion_p, draw_rate_interval, draw_rate_upper
from eval.statistics.evidence import (
    CONFIDENCE,
    family_confidence,
    further_hours,
    rate_interval,
    rate_upper,
    share_upper,
)
from eval.statistics.numbers import Number, figure, number
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
        further=tuple(
            FurtherHours(
                mtbf_h=mtbf,
                hours=further_hours(mtbf, total, exposure),
                same_rate_hours=further_hours(mtbf, 2 * total, exposure),
            )
            for mtbf in MTBF_WANTED_H
        ),
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
    of_all = event_statement(
        found.hard_events,
        counts.running_hours,
        f"{counts.robots} draws",
        (found.hard_rate_upper, found.draw_rate_upper, found.bad_draw_upper),
        (counts.availability, counts.goal_success),
    )
    if not counts.core_goals:
        return of_all
    return f"{of_all} Goals {counts.core_goals} reached: {100 * counts.core_success:.2f} %."


def event_statement(
    events: int, hours: float, draws: str, bounds: tuple[Number, Number, float], shares: tuple[float, float]
) -> str:
    """Return the sentence that the counts support: events, bounds of their rate, availability and goals.

    Args:
        events: hard ones. hours: operating time. draws: number of draws in words.
        bounds: of the rate if draws are alike, of the rate if they differ, and of the probability of a bad draw.
        shares: availability, and goals reached ÷ goals due.
    """
    alike, differ, bad_draw = bounds
    bound = "no bound on the rate" if alike is None else f"rate ≤ {figure(alike, 2)} per hour"
    if differ is not None:
        bound += f" (≤ {figure(differ, 2)} where draws differ)"
    availability, goals = (100 * share for share in shares)
    return (
        f"{events:,} hard event{'s' if events != 1 else ''} in {figure(hours)} hours of operating time over {draws}:"
        f" {bound}, P(bad draw) ≤ {bad_draw:.2g} (each with {100 * CONFIDENCE:.0f} % confidence),"
        f" availability {availability:.2f} %, goals reached {goals:.2f} %."
    )


def dispersion_sentence(p: float, events: int, draws: int) -> str:
    """Return what the p-value `p` of equal rates says about differences between draws."""
    if events < 2:
        return "Fewer than two hard events cannot show whether draws differ."
    chance = (
        f"chance alone spreads {events:,} hard events over {draws:,} draws this unevenly"
        f" in {100 * p:.2g} % of cases"
    )
    if p <= 1 - CONFIDENCE:
        return f"Draws differ: {chance}. Only the bound for differing draws is valid."
    return f"Draws were not shown to differ: {chance}. Few events cannot show it, so both bounds are given."
