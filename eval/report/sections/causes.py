"""Section "causes": rank correlations of robot parameters with failures."""

import numpy as np

from eval.judge.counts import Counts
from eval.report.schema.rows import Sensitivity
from eval.report.sections.verdict import operating_hours
from eval.report.soak_result import SoakResult
from eval.statistics.evidence import CONFIDENCE
from eval.statistics.numbers import number
from eval.statistics.sensitivity import CorrelationTable, correlate
from robots.arrays import Floats

CAUSES_SHOWN = 10


def sensitivity(result: SoakResult) -> Sensitivity:
    """Return the strongest correlations of a parameter with an outcome."""
    operated = (result.counts.running > 0) & (result.counts.due > 0)
    table = correlate(
        {name: column[operated] for name, column in result.parameters.items()},
        {name: column[operated] for name, column in outcomes(result.counts).items()},
    )
    draws = int(operated.sum())
    return Sensitivity(
        draws=draws,
        parameters=len(table.parameters),
        outcomes=table.outcomes,
        noticeable=number(table.noticeable, 3),
        causes=table.correlations[:CAUSES_SHOWN],
        statement=_statement(table, draws),
    )


def outcomes(counts: Counts) -> dict[str, Floats]:
    """Return failures (R,) of each draw by name; NaN or infinite for a draw without operating time."""
    with np.errstate(divide="ignore", invalid="ignore"):
        hours = operating_hours(counts)
        return {
            "goals missed": 1 - counts.reached / counts.due,
            "stops per hour": counts.stops / hours,
            "hard events per hour": counts.hard_events() / hours,
        }


def _statement(table: CorrelationTable, draws: int) -> str:
    if not table.outcomes:
        return (
            f"No failures to explain: goals missed, stops and hard events are the same in all {draws} draws."
        )
    if not table.parameters:
        return "No parameter can explain failures: none differs between draws."
    data = f"{draws} draws and {len(table.parameters)} parameters"
    if np.isinf(table.noticeable):
        return f"With {data}, no correlation can be significant."
    significant = [pair for pair in table.correlations if pair.p <= 1 - CONFIDENCE]
    threshold = f"With {data}, a rank correlation is significant from ±{table.noticeable:.2f} on"
    if not significant:
        return f"{threshold}. None is: all correlations below may be chance."
    verb = "is" if len(significant) == 1 else "are"
    strongest = significant[0]
    return f"{threshold}. {len(significant)} {verb}, the strongest: {strongest.outcome} with {strongest.parameter}."
