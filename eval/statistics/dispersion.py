"""Confidence bounds of event rates when draws differ, so that events cluster in some robots.

A robot with a bad draw can have dozens of events, and bounds that assume the same rate in all hours are then too
narrow. Here a draw's rate has a gamma distribution and its events are Poisson at that rate, hence negative binomial.
The spread, (standard deviation ÷ mean)² of the rates, is unknown: its upper bound is used, limited to `UNSEEN` or to
the estimated spread, whichever is larger. These bounds are never tighter than those of `eval.statistics.evidence` and
hold whether draws differ or not. Choosing between the two by `dispersion_p` would lose coverage, since few events
cannot show that draws differ: a nominal 95 % would cover 87 % at 16 draws of spread 2, and 92 % at spread 1/2.

Actual coverage of a nominal 95 %, with at least 3 expected events, two-sided and one-sided:
    8 to 256 draws with any hours: without spread 96 %, spread 1 96 %, spread 2 94 %;
    16 draws with log-normal rates, σ = 1: 95 % two-sided, 93 % one-sided;
    spread 4: 89 % at 16 draws, 92 % at 64; spread 10: 81 % and 91 %.
A kind of draw too rare to be in the sample is not covered: if one draw in ten has ten times the events of the
others, 16 draws contain none of them in 19 soaks of 100. Only `evidence.share_upper` of bad draws bounds that.
A bootstrap over draws has the same limit: at 16 draws of spread 2 its nominal 95 % covers 81 to 89 % by percentiles
and 87 to 92 % by BCa, and without events it returns 0.

Source: Greenwood and Yule, An inquiry into the nature of frequency distributions, J. R. Stat. Soc. 83 (1920).
"""

from typing import cast

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from eval.statistics.evidence import CONFIDENCE
from robots.arrays import Floats

UNSEEN = 2.0  # gamma shape 1/2: 5 % of draws hold 28 % of the events
RESAMPLES = 9999
RESAMPLED_MAX = 1 << 27
"""Draws of all samples together, which take up to two minutes of a core: with more than 13,000, samples are fewer."""
_BATCH_NUMBERS = 1 << 22  # bounds the memory of resampling, whatever the number of draws
_SPREAD_MIN = 1e-9  # avoids division by zero where draws do not differ


def dispersion_p(events: ArrayLike, hours: ArrayLike, draws: int | None = None) -> float:
    """Return the p-value of equal rates in all draws: how often chance spreads the events at least as unevenly.

    The statistic is Fisher's index of dispersion Σ(x - μ)²/μ with μ in proportion to hours. Its χ²(n - 1) needs about
    five events per draw, so the p-value is that of the exact distribution given the total, multinomial, from
    `RESAMPLES` samples, fewer of many draws, with a fixed seed. It is 1 for fewer than two events. Draws without hours
    are ignored.

    Args:
        events, hours: (n,) of each draw.
        draws: in all groups whose p-values are wanted; n by default. It bounds the number of samples.

    Source: Fisher, The significance of deviations from expectation in a Poisson series, Biometrics 6 (1950);
    Phipson and Smyth, Permutation p-values should never be zero, Stat. Appl. Genet. Mol. Biol. 9 (2010).
    """
    x, h = np.asarray(events), np.asarray(hours, dtype=np.float64)
    x, h = x[h > 0], h[h > 0]
    total = int(x.sum())
    if total < 2:
        return 1.0
    share, rng = h / h.sum(), np.random.default_rng(0)
    test = stats.monte_carlo_test(
        x,
        lambda size: rng.multinomial(total, share, size=size[0]),
        lambda x, axis: ((x - total * share) ** 2 / (total * share)).sum(axis=axis),
        vectorized=True,
        n_resamples=min(RESAMPLES, max(1, RESAMPLED_MAX // (draws or len(x)))),
        batch=max(1, _BATCH_NUMBERS // len(x)),
        alternative="greater",
    )
    return float(test.pvalue)


def draw_rate_upper(events: ArrayLike, hours: ArrayLike, confidence: float = CONFIDENCE) -> Floats:
    """Return the upper bound of the rate, per hour, over draws that may differ; infinite without exposure.

    Instead of χ²(2x + 2) in `evidence.rate_upper` it uses the F distribution with 2x + 2 and 2r degrees of freedom,
    r = draws ÷ spread, from the negative binomial tail. Without events it is 3.63 ÷ hours for n = 16, 3.14 for 64,
    3.00 for many draws.

    Args:
        events: (n, ...) of each draw. hours: (n,) of each draw.
        confidence: one-sided, above 1/2.

    Source: Patil, On the evaluation of the negative binomial distribution, Technometrics 2 (1960), its tail as
    a beta distribution, that is F; spread by moments: Breslow, Extra-Poisson variation in log-linear models,
    Appl. Stat. 33 (1984); draws with unequal hours: Kish, Survey Sampling (1965), Σh² in place of (Σh)²/n.
    """
    total, exposure, r = _pooled(events, hours, confidence)
    if exposure <= 0:
        return np.full_like(total, np.inf)
    return cast(Floats, (total + 1) / exposure * stats.f.ppf(confidence, 2 * total + 2, 2 * r))


def draw_rate_lower(events: ArrayLike, hours: ArrayLike, confidence: float = CONFIDENCE) -> Floats:
    """Return the lower bound of the rate, per hour, over draws that may differ; 0 without events.

    Args and source: as `draw_rate_upper`.
    """
    total, exposure, r = _pooled(events, hours, confidence)
    if exposure <= 0:
        return np.zeros_like(total)
    quantile = stats.f.ppf(1 - confidence, np.maximum(2 * total, _SPREAD_MIN), 2 * r)
    return np.where(total > 0, total / exposure * quantile, 0.0)


def draw_rate_interval(
    events: ArrayLike, hours: ArrayLike, confidence: float = CONFIDENCE
) -> tuple[Floats, Floats]:
    """Return the central interval of the rate, per hour, over draws that may differ; `confidence` is two-sided.

    Args and source: as `draw_rate_upper`.
    """
    each = (1 + confidence) / 2
    return draw_rate_lower(events, hours, each), draw_rate_upper(events, hours, each)


def _pooled(events: ArrayLike, hours: ArrayLike, confidence: float) -> tuple[Floats, float, Floats]:
    """Total events, total hours, and the equivalent number of draws of spread 1.

    The bound of the spread may fail twice as often as the result: it harms only where the total fails the same way.
    """
    x, h = np.asarray(events, dtype=np.float64), np.asarray(hours, dtype=np.float64)
    total, exposure = x.sum(axis=0), float(h.sum())
    with np.errstate(divide="ignore", invalid="ignore"):
        draws = exposure**2 / (h**2).sum()
        uneven = draws * ((x - np.multiply.outer(h / exposure, total)) ** 2).sum(axis=0)
        likely = _spread(total, uneven, draws, draws - 1)
        most = _spread(total, uneven, draws, stats.chi2.ppf(2 * (1 - confidence), draws - 1))
        spread = np.minimum(most, np.maximum(likely, UNSEEN))
    return total, exposure, draws / np.maximum(np.where(np.isnan(spread), UNSEEN, spread), _SPREAD_MIN)


def _spread(total: Floats, uneven: Floats, draws: float, freedom: float) -> Floats:
    """Variance of the draws' rates ÷ mean², without the part due to chance; NaN without events or with one draw."""
    return draws / total * np.maximum(uneven / (total * freedom) - 1, 0)
