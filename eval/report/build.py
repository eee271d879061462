"""From what a soak hands over to what report.json says."""

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
    GoalBin,
    Goals,
    Heat,
    Ints,
    Line,
    MonitorRow,
    Report,
    SoakResult,
    Stops,
    Verdict,
    median,
    number,
    series,
)
from eval.report.wear import wear

EVENTS_LISTED = 500
POINTS = 500
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
            found=number(finding.found),
            passed=finding.passed,
        )
        for finding in check(budget, counts)
    )
    exposure, evidence, goals = _exposure(counts), _evidence(counts), _goals(result)
    at = np.arange(0, len(result.sample_h), -(-len(result.sample_h) // POINTS))
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
        sample_h=tuple(round(float(hour), 4) for hour in result.sample_h[at]),
        heat=_heat(result, at),
        wear=tuple(wear(result, at)),
        unseen=(*_unseen(counts, evidence), *result.unseen),
    )


def _verdict(result: SoakResult, lines: Sequence[Line]) -> Verdict:
    if result.run.interrupted:
        return "interrupted"
    return "passed" if all(line.passed for line in lines) else "failed"


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
        hard_rate_upper=number(float(rate_upper(hard, hours))),
        bad_draws=bad,
        bad_draw_upper=float(share_upper(bad, counts.robots)),
    )


def _goals(result: SoakResult) -> Goals:
    counts = result.counts
    due, reached = counts.goals_due, int(counts.reached.sum())
    low, high = share_interval(reached, due)
    bins = tuple(_bins(result))
    return Goals(
        due=due,
        reached=reached,
        success=counts.goal_success,
        low=float(low),
        high=float(high),
        bins=bins,
        change=_change([each for each in bins if each.attempted]),
    )


def _bins(result: SoakResult) -> Iterator[GoalBin]:
    width, end = result.goals_bin_h, float(result.sample_h[-1])
    found = zip(result.goals_attempted.tolist(), result.goals_reached.tolist(), strict=True)
    for k, (attempted, reached) in enumerate(found):
        low, high = share_interval(reached, attempted)
        yield GoalBin(
            start_h=k * width,
            end_h=min((k + 1) * width, end),
            attempted=attempted,
            reached=reached,
            low=float(low),
            high=float(high),
        )


def _change(bins: Sequence[GoalBin]) -> str:
    """What bins with goals tell about the end of the run against its start, as far as chance lets them."""
    if len(bins) < 2:
        return "Goals came in one part of the run at most: there is no later one to compare it with."
    first, last = bins[0], bins[-1]
    verdict = "overlap: no change is shown"
    if last.high < first.low:
        verdict = "lie apart: the end is worse than the start"
    elif last.low > first.high:
        verdict = "lie apart: the end is better than the start"
    return f"Goals reached {_said(first)}; {_said(last)}. The 95 % intervals {verdict}."


def _said(b: GoalBin) -> str:
    success, low, high = (100 * share for share in (b.reached / b.attempted, b.low, b.high))
    return (
        f"from hour {b.start_h:.3g} to {b.end_h:.3g}: {success:.2f} % ({low:.2f} to {high:.2f} %)"
        f" of {b.attempted:,}"
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
        rate_upper=number(float(rate_upper(events, counts.running_hours))),
        channels=tuple(
            Channel(
                joint=joint,
                limit=float(counts.limits[channel]),
                events=int(counts.events[:, channel].sum()),
                bad_ticks=int(counts.bad_ticks[:, channel].sum()),
                worst=number(float(counts.worst[:, channel].max(initial=0.0))),
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
            worst=number(event.worst),
        )
        for event in log[:EVENTS_LISTED]
    )


def _heat(result: SoakResult, at: Ints) -> tuple[Heat, ...]:
    """Between samples `at` and their next the hottest is kept, not the last."""
    hottest = np.fmax.reduceat(np.fmax.reduce(result.winding_c, axis=1), at, axis=0)
    usual = median(result.winding_c[at])
    return tuple(
        Heat(
            joint=joint,
            soft_c=float(result.winding_soft_c[k]),
            max_c=float(result.winding_max_c[k]),
            median_c=series(usual[:, k], 2),
            hottest_c=series(hottest[:, k], 2),
        )
        for k, joint in enumerate(result.counts.joints)
    )


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
