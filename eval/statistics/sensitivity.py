"""Rank correlation of the drawn robot parameters with failures: a sensitivity analysis over draws.

Parameters are drawn independently, so a parameter that correlates with failures beyond chance is a cause of them, or
identical with one. The measure is Spearman's rank correlation of each parameter with each outcome. As many pairs are
tested, the p-value of a pair is family-wise: how often the largest correlation of all pairs would be as large if the
outcomes were permuted over the draws, all outcomes of a draw together. That is exact for any number of draws, with
ties, and with dependent parameters or outcomes, unlike Holm's correction of tabulated p-values: most draws have no
hard event at all.

Few draws show only strong correlations; `CorrelationTable.noticeable` is the least that is significant.

Source: Spearman, The proof and measurement of association between two things, Am. J. Psychol. 15 (1904); Westfall and
Young, Resampling-Based Multiple Testing (1993), the single-step maxT; Phipson and Smyth, Permutation p-values should
never be zero, Stat. Appl. Genet. Mol. Biol. 9 (2010).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy import stats

from eval.statistics.evidence import CONFIDENCE
from eval.statistics.numbers import Share
from robots.arrays import Floats
from robots.distributions import Distributions
from robots.draws import Draw
from robots.strict import Strict

RESAMPLES = 1999
_ROUNDING = 1e-9  # correlations that differ by less are equal


class Cause(Strict):
    """Spearman's rank correlation `rho` of a parameter with an outcome over the draws, and its family-wise `p`."""

    parameter: str
    outcome: str
    rho: Annotated[float, Field(ge=-1, le=1)]
    p: Share


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrelationTable:
    """Correlations of all pairs, the strongest first.

    Attributes:
        parameters, outcomes: names of those that differ between draws.
        noticeable: the least absolute correlation that is significant at `CONFIDENCE`; infinite if none can be.
    """

    parameters: tuple[str, ...]
    outcomes: tuple[str, ...]
    noticeable: float
    correlations: tuple[Cause, ...]


def parameter_values(draw: Draw, distributions: Distributions) -> dict[str, Floats]:
    """Return (B,) by quantity: the mean over joints or sensors, or the root mean square where it can be negative."""
    spans = [(name, span.low < 0 < span.high) for name, _, span in distributions.spans()]
    return {name: _aggregate(draw[name].reshape(draw.robots, -1), signed) for name, signed in spans}


def _aggregate(values: Floats, signed: bool) -> Floats:
    return np.asarray(np.sqrt((values**2).mean(axis=1)) if signed else values.mean(axis=1))


def correlate(
    parameters: Mapping[str, Floats], outcomes: Mapping[str, Floats], resamples: int = RESAMPLES
) -> CorrelationTable:
    """Correlate every parameter with every outcome.

    Args:
        parameters, outcomes: (R,) by name, of the same draws; finite. Constant ones are left out.
        resamples: number of permutations, with a fixed seed.
    """
    x, y = _ranked(parameters), _ranked(outcomes)
    if not x or not y:
        return CorrelationTable(parameters=tuple(x), outcomes=tuple(y), noticeable=np.inf, correlations=())
    x_ranks, y_ranks = np.stack(list(x.values())), np.stack(list(y.values()), axis=1)
    rho, rng = x_ranks @ y_ranks, np.random.default_rng(0)
    chance = np.sort([np.abs(x_ranks @ rng.permutation(y_ranks)).max() for _ in range(resamples)])
    larger = resamples - np.searchsorted(chance, np.abs(rho) - _ROUNDING)
    p = (1 + larger) / (1 + resamples)
    correlations = [
        Cause(parameter=parameter, outcome=outcome, rho=float(np.clip(rho[i, k], -1, 1)), p=float(p[i, k]))
        for i, parameter in enumerate(x)
        for k, outcome in enumerate(y)
    ]
    return CorrelationTable(
        parameters=tuple(x),
        outcomes=tuple(y),
        noticeable=_noticeable(chance),
        correlations=tuple(sorted(correlations, key=lambda each: -abs(each.rho))),
    )


def _ranked(columns: Mapping[str, Floats]) -> dict[str, Floats]:
    """Ranks minus their mean, scaled to length 1: their products are Spearman's correlations."""
    ranks = {name: stats.rankdata(column) - (len(column) + 1) / 2 for name, column in columns.items()}
    return {name: rank / np.linalg.norm(rank) for name, rank in ranks.items() if rank.any()}


def _noticeable(chance: Floats) -> float:
    """Least correlation with a p-value of 1 - CONFIDENCE, from the sorted maxima (N,); infinite if there is none."""
    allowed = int((1 - CONFIDENCE) * (1 + len(chance)) + _ROUNDING) - 1
    quantile = chance[len(chance) - 1 - allowed] if allowed >= 0 else np.inf
    # A quantile equal to the maximum is the largest value that these ranks, with their ties, can have.
    return float(quantile) + 2 * _ROUNDING if quantile < chance[-1] - _ROUNDING else np.inf
