"""Which of the numbers that robots are drawn with go with what went wrong in them.

Every quantity is drawn by itself, so one that goes with failures beyond chance is a cause of them, or a cause's other
name: nothing else could have set it. What is looked for is Spearman's rank correlation of each parameter with each
outcome, and many pairs are looked at. The p-value of a pair is that of the whole family: how often the largest
correlation of all pairs would be as large if outcomes were dealt to the draws anew, all outcomes of a draw together.
That is exact for any number of draws, with any ties, and however parameters or outcomes depend on each other, which
Holm's correction of tabulated p-values is not: most draws have no hard event at all.

With few draws only what is strong can be told from chance; `Found.noticeable` says how strong.

Source: Spearman, The proof and measurement of association between two things, Am. J. Psychol. 15 (1904); Westfall and
Young, Resampling-Based Multiple Testing (1993), the single-step maxT; Phipson and Smyth, Permutation p-values should
never be zero, Stat. Appl. Genet. Mol. Biol. 9 (2010).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from eval.statistics.evidence import CONFIDENCE
from robots.arrays import Floats
from robots.distributions import Distributions
from robots.draws import Draw

RESAMPLES = 1999
_SAME = 1e-9  # two correlations that differ by rounding alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """A parameter and an outcome: their rank correlation, and the p-value among all pairs together."""

    parameter: str
    outcome: str
    rho: float
    p: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """All pairs, the strongest first.

    Attributes:
        parameters, outcomes: names of those that differ from draw to draw.
        noticeable: the least correlation, of either sign, that `CONFIDENCE` tells from chance; infinite for none.
    """

    parameters: tuple[str, ...]
    outcomes: tuple[str, ...]
    noticeable: float
    pairs: tuple[Pair, ...]


def parameters(draw: Draw, distributions: Distributions) -> dict[str, Floats]:
    """One number (B,) for each quantity: the mean of its joints or sensors, or its size where it has a sign.

    A size is the root mean square: a sensor may lie to either side.
    """
    spans = [(name, span.low < 0 < span.high) for name, _, span in distributions.spans()]
    return {name: _one(draw[name].reshape(draw.robots, -1), signed) for name, signed in spans}


def _one(values: Floats, signed: bool) -> Floats:
    return np.asarray(np.sqrt((values**2).mean(axis=1)) if signed else values.mean(axis=1))


def explain(given: Mapping[str, Floats], outcomes: Mapping[str, Floats], resamples: int = RESAMPLES) -> Found:
    """Correlate every parameter with every outcome.

    Args:
        given, outcomes: (R,) by name, of the same draws; finite. Those that are the same for all draws are left out.
        resamples: how often outcomes are dealt anew, always in the same ways.
    """
    x, y = _ranked(given), _ranked(outcomes)
    if not x or not y:
        return Found(parameters=tuple(x), outcomes=tuple(y), noticeable=np.inf, pairs=())
    of_x, of_y = np.stack(list(x.values())), np.stack(list(y.values()), axis=1)
    rho, rng = of_x @ of_y, np.random.default_rng(0)
    chance = np.sort([np.abs(of_x @ rng.permutation(of_y)).max() for _ in range(resamples)])
    larger = resamples - np.searchsorted(chance, np.abs(rho) - _SAME)
    p = (1 + larger) / (1 + resamples)
    pairs = [
        Pair(parameter=one, outcome=other, rho=float(np.clip(rho[i, k], -1, 1)), p=float(p[i, k]))
        for i, one in enumerate(x)
        for k, other in enumerate(y)
    ]
    return Found(
        parameters=tuple(x),
        outcomes=tuple(y),
        noticeable=_noticeable(chance),
        pairs=tuple(sorted(pairs, key=lambda pair: -abs(pair.rho))),
    )


def _ranked(columns: Mapping[str, Floats]) -> dict[str, Floats]:
    """Ranks about their mean, of length 1: their products are Spearman's correlations."""
    ranks = {name: stats.rankdata(column) - (len(column) + 1) / 2 for name, column in columns.items()}
    return {name: rank / np.linalg.norm(rank) for name, rank in ranks.items() if rank.any()}


def _noticeable(chance: Floats) -> float:
    """The least that few enough of sorted (N,) reach for a p-value of 1 - CONFIDENCE; infinite where none can be it."""
    allowed = int((1 - CONFIDENCE) * (1 + len(chance)) + _SAME) - 1
    most = chance[len(chance) - 1 - allowed] if allowed >= 0 else np.inf
    # What so many reach is the largest that these ranks, with their ties, can have.
    return float(most) + 2 * _SAME if most < chance[-1] - _SAME else np.inf
