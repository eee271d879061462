"""Which of the numbers that robots are drawn with explain what went wrong: the section of the report."""

import numpy as np

from eval.judge.counts import Counts
from eval.report.schema.numbers import number
from eval.report.schema.report_data import SoakResult
from eval.report.schema.rows import Cause, Sensitivity
from eval.report.sections.bounds import hours_under_way
from eval.statistics.evidence import CONFIDENCE
from eval.statistics.sensitivity import Found, explain
from robots.arrays import Floats

SHOWN = 10


def sensitivity(result: SoakResult) -> Sensitivity:
    """The strongest pairs of a parameter and an outcome."""
    counts = result.counts
    at_work = (counts.running > 0) & (counts.due > 0)
    found = explain(
        {name: column[at_work] for name, column in result.parameters.items()},
        {name: column[at_work] for name, column in outcomes(counts).items()},
    )
    draws = int(at_work.sum())
    return Sensitivity(
        draws=draws,
        parameters=len(found.parameters),
        outcomes=found.outcomes,
        noticeable=number(found.noticeable, 3),
        causes=tuple(
            Cause(parameter=each.parameter, outcome=each.outcome, rho=each.rho, p=each.p)
            for each in found.pairs[:SHOWN]
        ),
        said=_said(found, draws),
    )


def outcomes(counts: Counts) -> dict[str, Floats]:
    """(R,) what went wrong in each draw, by name; NaN or infinite for one that never was at work."""
    with np.errstate(divide="ignore", invalid="ignore"):
        hours = hours_under_way(counts)
        return {
            "goals missed": 1 - counts.reached / counts.due,
            "stops per hour": counts.stops / hours,
            "hard events per hour": counts.hard_events() / hours,
        }


def _said(found: Found, draws: int) -> str:
    if not found.outcomes:
        return (
            f"Nothing to explain: goals missed, stops and hard events are the same in all of {draws} draws."
        )
    if not found.parameters:
        return "Nothing to explain it by: no parameter differs from draw to draw."
    few = f"{draws} draws and {len(found.parameters)} parameters"
    if np.isinf(found.noticeable):
        return f"With {few} nothing can stand out of chance."
    shown = [pair for pair in found.pairs if pair.p <= 1 - CONFIDENCE]
    least = f"With {few}, a rank correlation stands out of chance from ±{found.noticeable:.2f} on"
    if not shown:
        return f"{least}. None does: what follows may all be chance."
    many = f"{len(shown)} do{'es' if len(shown) == 1 else ''}"
    return f"{least}. {many}, the strongest: {shown[0].outcome} with {shown[0].parameter}."
