"""Build of the report's data from the results of a soak."""

from collections.abc import Sequence

import numpy as np

from eval.history.soak_record import Verdict
from eval.judge.counts import REASON_NAMES, Counts
from eval.report.schema.report_data import Exposure, Report, Stops
from eval.report.sections.causes import sensitivity
from eval.report.sections.faults import fault_line
from eval.report.sections.goals import goals
from eval.report.sections.heat import heat
from eval.report.sections.judged import events, monitors, robots
from eval.report.sections.limitations import limitations
from eval.report.sections.verdict import evidence, statement
from eval.report.sections.wear import wear
from eval.report.soak_result import SoakResult
from eval.statistics.budget import Budget, BudgetLine, check
from eval.statistics.per_draw_counts import PerDrawCounts

TAIL = 1e-4
CURVE_POINTS = 500


def build(result: SoakResult, budget: Budget) -> Report:
    """Check a soak against a budget and return all data of its report."""
    counts = result.counts
    faults = () if result.faults is None else (fault_line(result.faults),)
    lines = (*faults, *check(budget, counts))
    found = evidence(counts)
    at = np.arange(0, len(result.sample_h), -(-len(result.sample_h) // CURVE_POINTS))
    report = Report(
        format=2,
        verdict=_verdict(result, lines),
        statement=statement(counts, found),
        settings=result.settings,
        run=result.run,
        per_draw_counts=PerDrawCounts.from_counts(counts),
        budget=lines,
        exposure=_exposure(counts),
        evidence=found,
        goals=goals(result),
        stops=_stops(counts),
        monitors=monitors(counts, TAIL),
        tail_share=TAIL,
        events=events(counts, result.bundles),
        robots=robots(result),
        sensitivity=sensitivity(result),
        sample_h=tuple(round(float(hour), 4) for hour in result.sample_h[at]),
        heat=heat(result, at),
        wear=tuple(wear(result, at)),
        faults=result.faults,
        trend=None,
        limitations=tuple(limitations(counts, found, faults=result.faults is not None)),
    )
    return report.model_copy(update={"results_digest": report.sealed()})


def _verdict(result: SoakResult, lines: Sequence[BudgetLine]) -> Verdict:
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


def _stops(counts: Counts) -> Stops:
    reasons = zip(REASON_NAMES, counts.reasons.sum(axis=0).tolist(), strict=True)
    return Stops(
        total=int(counts.stops.sum()),
        latches=int(counts.latches.sum()),
        reasons={name: times for name, times in reasons if times},
    )
