"""How sure counts allow us to be when draws differ: events that bunch in some robots.

A robot with a bad draw has its events by the dozen, and bounds that take all hours as alike are then too
narrow. Here a draw's rate comes from a gamma distribution, and its events are Poisson at that rate, hence
negative binomial. Their spread, (standard deviation ÷ mean)² of the rates, is not known: it is taken at its
upper bound, yet at no more than `UNSEEN` or, if that is more, what it looks like. So these bounds are never
tighter than those of `eval.statistics.evidence` and hold whether draws differ or not. Choosing between the two by
`dispersion_p` would break the promise, since few events cannot show that draws differ: a nominal 95 % then
covers 87 % at 16 draws of spread 2, and 92 % at spread 1/2.

What a nominal 95 % covers, where 3 events or more are to be expected, two-sided and one-sided:
    8 to 256 draws with any hours: without spread 96 %, spread 1 96 %, spread 2 94 %;
    16 draws with log-normal rates, σ = 1: 95 % two-sided, 93 % one-sided;
    spread 4: 89 % at 16 draws, 92 % at 64; spread 10: 81 % and 91 %.
A kind of draw too rare to be among those drawn is not covered: of one in ten with ten times the events of the
others, 16 draws hold none in 19 nights of 100. `evidence.share_upper` of bad draws is the only word on it.
A bootstrap over draws knows no draw but these either: at 16 draws of spread 2 its nominal 95 % covers 81 to
89 % by percentiles and 87 to 92 % by BCa, and without events it says 0.

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
_AT_ONCE = 1 << 22  # numbers in memory while resampling, whatever the number of draws
_ALIKE = 1e-9  # a spread that is none, to nine digits


def dispersion_p(events: ArrayLike, hours: ArrayLike) -> float:
    """P-value of draws that are alike: how often chance spreads as many events over them at least as unevenly.

    Fisher's index of dispersion Σ(x - μ)²/μ with μ in proportion to hours. Its χ²(n - 1) needs some five events
    a draw, so the p-value is that of the exact distribution given the total, multinomial, from `RESAMPLES` of
    it and always the same ones. Fewer than two events show nothing: 1. Draws without hours have no say.

    Args:
        events, hours: (n,) of each draw.

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
        n_resamples=RESAMPLES,
        batch=max(1, _AT_ONCE // len(x)),
        alternative="greater",
    )
    return float(test.pvalue)


def draw_rate_upper(events: ArrayLike, hours: ArrayLike, confidence: float = CONFIDENCE) -> Floats:
    """Upper bound of the rate, per hour, over draws that may differ; infinite without exposure.

    Where `evidence.rate_upper` has χ²(2x + 2), this has the F of 2x + 2 and 2r degrees of freedom, r = draws ÷
    spread, from the negative binomial tail. Without events: 3.63 ÷ hours for n = 16, 3.14 for 64, 3.00 for many.

    Args:
        events: (n, ...) of each draw. hours: (n,), draws by their own.
        confidence: of one side, above 1/2.

    Source: Patil, On the evaluation of the negative binomial distribution, Technometrics 2 (1960), its tail as
    a beta distribution, that is F; spread by moments: Breslow, Extra-Poisson variation in log-linear models,
    Appl. Stat. 33 (1984); draws with unequal hours: Kish, Survey Sampling (1965), Σh² in place of (Σh)²/n.
    """
    total, exposure, r = _pooled(events, hours, confidence)
    if exposure <= 0:
        return np.full_like(total, np.inf)
    return cast(Floats, (total + 1) / exposure * stats.f.ppf(confidence, 2 * total + 2, 2 * r))


def draw_rate_lower(events: ArrayLike, hours: ArrayLike, confidence: float = CONFIDENCE) -> Floats:
    """Lower bound of the rate, per hour, over draws that may differ; 0 without events.

    Args:
        events, hours, confidence: as `draw_rate_upper`.

    Source: Patil (1960), as `draw_rate_upper`.
    """
    total, exposure, r = _pooled(events, hours, confidence)
    if exposure <= 0:
        return np.zeros_like(total)
    quantile = stats.f.ppf(1 - confidence, np.maximum(2 * total, _ALIKE), 2 * r)
    return np.where(total > 0, total / exposure * quantile, 0.0)


def draw_rate_interval(
    events: ArrayLike, hours: ArrayLike, confidence: float = CONFIDENCE
) -> tuple[Floats, Floats]:
    """Central interval of the rate, per hour, over draws that may differ.

    Args:
        events, hours: as `draw_rate_upper`. confidence: of both sides.

    Source: Patil (1960), as `draw_rate_upper`.
    """
    each = (1 + confidence) / 2
    return draw_rate_lower(events, hours, each), draw_rate_upper(events, hours, each)


def _pooled(events: ArrayLike, hours: ArrayLike, confidence: float) -> tuple[Floats, float, Floats]:
    """Events, hours, and as how many draws of spread 1 these count.

    The spread's bound may err twice as often as the whole: it harms only where the total errs the same way.
    """
    x, h = np.asarray(events, dtype=np.float64), np.asarray(hours, dtype=np.float64)
    total, exposure = x.sum(axis=0), float(h.sum())
    with np.errstate(divide="ignore", invalid="ignore"):
        draws = exposure**2 / (h**2).sum()
        uneven = draws * ((x - np.multiply.outer(h / exposure, total)) ** 2).sum(axis=0)
        likely = _spread(total, uneven, draws, draws - 1)
        most = _spread(total, uneven, draws, stats.chi2.ppf(2 * (1 - confidence), draws - 1))
        spread = np.minimum(most, np.maximum(likely, UNSEEN))
    return total, exposure, draws / np.maximum(np.where(np.isnan(spread), UNSEEN, spread), _ALIKE)


def _spread(total: Floats, uneven: Floats, draws: float, freedom: float) -> Floats:
    """What is left of the variance of draws' rates ÷ mean² after chance; NaN without events or with one draw."""
    return draws / total * np.maximum(uneven / (total * freedom) - 1, 0)
