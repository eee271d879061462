"""From what a soak hands over to what report.json says."""

from collections.abc import Iterator, Sequence

import numpy as np

from eval.history.night_record import Verdict
from eval.judge.counts import REASONS, Counts
from eval.report.schema.numbers import median, number, series
from eval.report.schema.report_data import Exposure, GoalBin, Goals, Heat, Line, Report, SoakResult, Stops
from eval.report.schema.rows import Evidence
from eval.report.sections.bounds import evidence, statement
from eval.report.sections.causes import sensitivity
from eval.report.sections.faults import fault_line
from eval.report.sections.judged import events, monitors, robots
from eval.report.sections.wear import wear
from eval.statistics.budget import Budget, check
from eval.statistics.evidence import share_interval
from eval.statistics.per_draw_counts import Tally
from robots.arrays import Ints

TAIL = 1e-4
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
            allowed=number(finding.allowed),
            found=number(finding.found),
            passed=finding.passed,
        )
        for finding in check(budget, counts)
    )
    if result.faults is not None:
        lines = (fault_line(result.faults), *lines)
    found = evidence(counts)
    at = np.arange(0, len(result.sample_h), -(-len(result.sample_h) // POINTS))
    report = Report(
        format=2,
        verdict=_verdict(result, lines),
        statement=statement(counts, found),
        settings=result.settings,
        run=result.run,
        tally=Tally.of(counts),
        budget=lines,
        exposure=_exposure(counts),
        evidence=found,
        goals=_goals(result),
        stops=_stops(counts),
        monitors=monitors(counts, TAIL),
        tail_share=TAIL,
        events=events(counts, result.bundles),
        robots=robots(result),
        sensitivity=sensitivity(result),
        sample_h=tuple(round(float(hour), 4) for hour in result.sample_h[at]),
        heat=_heat(result, at),
        wear=tuple(wear(result, at)),
        faults=result.faults,
        trend=None,
        unseen=(*_unseen(counts, found), *result.unseen),
    )
    return report.model_copy(update={"results_digest": report.sealed()})


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


def _heat(result: SoakResult, at: Ints) -> tuple[Heat, ...]:
    """Between samples `at` and their next the hottest is kept, not the last."""
    hottest = np.fmax.reduceat(np.fmax.reduce(result.winding_c, axis=1), at, axis=0)
    usual, counts = median(result.winding_c[at]), result.counts
    peak = np.nan_to_num(counts.winding_c(), nan=-np.inf)
    above_h = counts.bad_ticks[:, counts.columns("heat_soft")] * counts.dt / 3600
    folded = np.ma.masked_invalid(result.folded_back).mean(axis=0).filled(0.0)
    return tuple(
        Heat(
            joint=joint,
            soft_c=float(result.winding_soft_c[k]),
            max_c=float(result.winding_max_c[k]),
            median_c=series(usual[:, k], 2),
            hottest_c=series(hottest[:, k], 2),
            peak_c=number(peak[:, k].max(), 2),
            hottest_robot=int(peak[:, k].argmax()),
            above_soft_h=float(above_h[:, k].sum()),
            longest_h=float(above_h[:, k].max()),
            longest_robot=int(above_h[:, k].argmax()),
            folded_back=float(folded[:, k].mean()),
            folded_most=float(folded[:, k].max()),
            folded_robot=int(folded[:, k].argmax()),
        )
        for k, joint in enumerate(counts.joints)
    )


def _unseen(counts: Counts, evidence: Evidence) -> Iterator[str]:
    """What follows from the counts alone about what they cannot tell."""
    yield (
        f"Most robots that could be drawn: with {evidence.bad_draws} of {counts.robots} draws bad, up to"
        f" {100 * evidence.bad_draw_upper:.0f} % of all may be. More draws lower this, more hours do not."
    )
    yield (f"What comes and goes between two control ticks: the judge looks every {1e3 * counts.dt:g} ms.")
    unjudged = [m.name for m in counts.monitors if np.isinf(counts.limits[counts.columns(m.name)]).any()]
    if unjudged:
        yield (
            f"What no limit is known of: {', '.join(unjudged)}. The policy's file does not say what it was trained on."
        )
    far = [
        monitor.name
        for monitor in counts.monitors
        if _worst(counts, monitor.name) < FAR and monitor.unit and monitor.name not in unjudged
    ]
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
