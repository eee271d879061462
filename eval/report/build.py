"""From what a soak hands over to what report.json says."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from eval.budget import Budget, check
from eval.counts import JOINT_MONITORS, MONITORS, REASONS, Counts, Monitor
from eval.evidence import CONFIDENCE, rate_upper, share_interval, share_upper
from eval.report.data import (
    Channel,
    EventRow,
    Evidence,
    Exposure,
    Floats,
    GoalBin,
    Goals,
    Heat,
    Line,
    MonitorRow,
    Report,
    SoakResult,
    Stops,
    Verdict,
)

EVENTS_LISTED = 500
HEAT_POINTS = 500
FAR = 0.5


def build(result: SoakResult, budget: Budget) -> Report:
    """Judge a soak by a budget and put everything that the report shows in one record."""
    counts = result.counts
    lines = tuple(
        Line(
            name=finding.name,
            unit=finding.unit,
            at_least=finding.at_least,
            allowed=finding.allowed,
            found=_number(finding.found),
            passed=finding.passed,
        )
        for finding in check(budget, counts)
    )
    exposure, evidence, goals = _exposure(counts), _evidence(counts), _goals(result)
    heat_h, heat = _heat(result)
    return Report(
        format=1,
        verdict=_verdict(result, lines),
        statement=_statement(exposure, evidence, goals),
        settings=result.settings,
        run=result.run,
        budget=lines,
        exposure=exposure,
        evidence=evidence,
        goals=goals,
        stops=_stops(counts),
        monitors=tuple(_monitor(counts, monitor) for monitor in MONITORS),
        events=_events(counts),
        heat_h=heat_h,
        heat=heat,
        unseen=(*_unseen(counts, evidence), *result.unseen),
    )


def _verdict(result: SoakResult, lines: Sequence[Line]) -> Verdict:
    if result.run.interrupted:
        return "interrupted"
    return "passed" if all(line.passed for line in lines) else "failed"


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _exposure(counts: Counts) -> Exposure:
    return Exposure(
        draws=counts.robots,
        ticks=int(counts.ticks.sum()),
        invalid_ticks=int(counts.invalid.sum()),
        evaluations=counts.evaluations,
        hours=counts.hours,
        running_hours=counts.running_hours,
        moving_hours=float(counts.moving.sum() * counts.dt / 3600),
        availability=counts.availability,
    )


def _evidence(counts: Counts) -> Evidence:
    hard = sum(counts.total(monitor.name) for monitor in MONITORS if monitor.hard)
    hours, bad = counts.running_hours, counts.bad_draws()
    return Evidence(
        confidence=CONFIDENCE,
        hard_events=hard,
        hard_rate=hard / hours if hours else None,
        hard_rate_upper=_number(float(rate_upper(hard, hours))),
        bad_draws=bad,
        bad_draw_upper=float(share_upper(bad, counts.robots)),
    )


def _goals(result: SoakResult) -> Goals:
    counts, width = result.counts, result.goals_bin_h
    due, reached = counts.goals_due, int(counts.reached.sum())
    low, high = share_interval(reached, due)
    bins = zip(result.goals_attempted.tolist(), result.goals_reached.tolist(), strict=True)
    return Goals(
        due=due,
        reached=reached,
        success=counts.goal_success,
        low=float(low),
        high=float(high),
        bins=tuple(
            GoalBin(start_h=k * width, end_h=(k + 1) * width, attempted=attempted, reached=hit)
            for k, (attempted, hit) in enumerate(bins)
        ),
    )


def _stops(counts: Counts) -> Stops:
    why = zip(REASONS, counts.reasons.sum(axis=0).tolist(), strict=True)
    return Stops(
        total=int(counts.stops.sum()),
        latches=int(counts.latches.sum()),
        reasons={name: times for name, times in why if times},
    )


def _monitor(counts: Counts, monitor: Monitor) -> MonitorRow:
    columns = counts.columns(monitor.name)
    names: Sequence[str | None] = counts.joints if monitor in JOINT_MONITORS else (None,)
    channels = zip(names, range(columns.start, columns.stop), strict=True)
    events = counts.total(monitor.name)
    return MonitorRow(
        name=monitor.name,
        unit=monitor.unit,
        hard=monitor.hard,
        meaning=monitor.meaning,
        evaluations=counts.evaluations,
        events=events,
        bad_draws=counts.bad_draws(monitor.name),
        rate_upper=_number(float(rate_upper(events, counts.running_hours))),
        channels=tuple(
            Channel(
                joint=joint,
                limit=float(counts.limits[channel]),
                events=int(counts.events[:, channel].sum()),
                bad_ticks=int(counts.bad_ticks[:, channel].sum()),
                worst=_number(float(counts.worst[:, channel].max(initial=0.0))),
            )
            for joint, channel in channels
        ),
    )


def _events(counts: Counts) -> tuple[EventRow, ...]:
    log = sorted(counts.log(), key=lambda event: (not event.monitor.hard, event.start, event.robot))
    return tuple(
        EventRow(
            robot=event.robot,
            monitor=event.monitor.name,
            joint=event.joint,
            hard=event.monitor.hard,
            start_h=event.start * counts.dt / 3600,
            length_s=event.ticks * counts.dt,
            worst=_number(event.worst),
        )
        for event in log[:EVENTS_LISTED]
    )


def _heat(result: SoakResult) -> tuple[tuple[float, ...], tuple[Heat, ...]]:
    """At most `HEAT_POINTS` times; between them the hottest is kept, not the last."""
    starts = np.arange(0, len(result.sample_h), max(1, math.ceil(len(result.sample_h) / HEAT_POINTS)))
    if not len(starts):
        return (), ()
    hottest = np.fmax.reduceat(np.fmax.reduce(result.winding_c, axis=1), starts, axis=0)
    median = np.ma.median(np.ma.masked_invalid(result.winding_c[starts]), axis=1).filled(np.nan)
    heat = tuple(
        Heat(
            joint=joint,
            soft_c=float(result.winding_soft_c[k]),
            max_c=float(result.winding_max_c[k]),
            median_c=_series(median[:, k]),
            hottest_c=_series(hottest[:, k]),
        )
        for k, joint in enumerate(result.counts.joints)
    )
    return tuple(round(float(hour), 4) for hour in result.sample_h[starts]), heat


def _series(values: Floats) -> tuple[float | None, ...]:
    return tuple(_number(round(float(value), 2)) for value in values)


def _statement(exposure: Exposure, evidence: Evidence, goals: Goals) -> str:
    """The sentence that the run supports, and no other."""
    rate = evidence.hard_rate_upper
    bound = "no bound on the rate" if rate is None else f"rate ≤ {rate:.2g} per hour"
    return (
        f"{evidence.hard_events} hard event{'s' if evidence.hard_events != 1 else ''} in"
        f" {exposure.running_hours:.1f} hours under way over {exposure.draws} draws:"
        f" {bound}, P(bad draw) ≤ {evidence.bad_draw_upper:.2g} (each with {100 * CONFIDENCE:.0f} %), availability"
        f" {100 * exposure.availability:.2f} %, goals reached {100 * goals.success:.2f} %."
    )


def _unseen(counts: Counts, evidence: Evidence) -> Iterator[str]:
    """What follows from the counts alone about what they cannot tell."""
    yield (
        f"Most robots that could be drawn: with {evidence.bad_draws} of {counts.robots} draws bad, up to"
        f" {100 * evidence.bad_draw_upper:.0f} % of all may be. More draws lower this, more hours do not."
    )
    yield (f"What comes and goes between two control ticks: the judge looks every {1e3 * counts.dt:g} ms.")
    far = [monitor.name for monitor in MONITORS if _worst(counts, monitor.name) < FAR and monitor.unit]
    if far:
        yield (
            f"How the stack behaves near limits that no robot used to {100 * FAR:.0f} %: {', '.join(far)}."
        )
    if counts.invalid.any():
        yield (
            f"{counts.invalid.sum()} ticks of the {np.count_nonzero(counts.invalid)} robots whose simulation"
            " diverged: nobody judged them."
        )


def _worst(counts: Counts, monitor: str) -> float:
    return float(counts.worst[:, counts.columns(monitor)].max(initial=0.0))
