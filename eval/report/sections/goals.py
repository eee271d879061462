"""Section "goals": goals reached, in total and over time."""

from collections.abc import Iterator, Sequence

from eval.judge.counts import Counts
from eval.report.schema.report_data import CoreGoalCounts, GoalBin, Goals
from eval.report.soak_result import SoakResult
from eval.statistics.evidence import share_interval


def goals(result: SoakResult) -> Goals:
    """Return goals due and reached with their interval, and the same over time."""
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
        core=_core(counts),
        bins=bins,
        change=_change([each for each in bins if each.attempted]),
    )


def _core(counts: Counts) -> CoreGoalCounts | None:
    """Return the core goals whose time is over; None where the task has none."""
    if not counts.core_goals:
        return None
    attempted, reached = int(counts.core_attempted.sum()), int(counts.core_reached.sum())
    low, high = share_interval(reached, attempted)
    return CoreGoalCounts(
        meaning=counts.core_goals,
        attempted=attempted,
        reached=reached,
        success=counts.core_success,
        low=float(low),
        high=float(high),
    )


def _bins(result: SoakResult) -> Iterator[GoalBin]:
    width, end = result.goals_bin_h, float(result.sample_h[-1])
    numbers = zip(result.goals_attempted.tolist(), result.goals_reached.tolist(), strict=True)
    for k, (attempted, reached) in enumerate(numbers):
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
    """Comparison of the last bin that has goals with the first one."""
    if len(bins) < 2:
        return "All goals were in one part of the soak: there is no later part to compare it with."
    first, last = bins[0], bins[-1]
    conclusion = "overlap: no change is shown"
    if last.high < first.low:
        conclusion = "do not overlap: the end is worse than the start"
    elif last.low > first.high:
        conclusion = "do not overlap: the end is better than the start"
    return f"Goals reached {_describe(first)}; {_describe(last)}. The 95 % intervals {conclusion}."


def _describe(b: GoalBin) -> str:
    success, low, high = (100 * share for share in (b.reached / b.attempted, b.low, b.high))
    return (
        f"from hour {b.start_h:.3g} to {b.end_h:.3g}: {success:.2f} % ({low:.2f} to {high:.2f} %)"
        f" of {b.attempted:,}"
    )
