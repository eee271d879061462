"""Confidence bounds of event rates, of the share of bad draws, and of the share of goals.

A bound is one-sided at `confidence`; an interval is two-sided with equal tails. Events are taken as Poisson in the
exposure and draws as independent. Hours of the same draw are not independent, so both the rate and the share of bad
draws must be reported; `eval.statistics.dispersion` bounds the rate where draws differ.
"""

from typing import cast

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from robots.arrays import Floats

CONFIDENCE = 0.95


def rate_upper(events: ArrayLike, hours: float, confidence: float = CONFIDENCE) -> Floats:
    """Return the upper bound of a Poisson rate, per hour; infinite without exposure.

    Without events it is -ln(1 - confidence) ÷ hours: 3.00 ÷ hours at 95 %.

    Source: Garwood, Fiducial limits for the Poisson distribution, Biometrika 28 (1936); without events:
    Hanley and Lippman-Hand, If nothing goes wrong, is everything all right?, JAMA 249 (1983).
    """
    return _chi_square(confidence, 2 * np.asarray(events) + 2, hours)


def rate_lower(events: ArrayLike, hours: float, confidence: float = CONFIDENCE) -> Floats:
    """Return the lower bound of a Poisson rate, per hour; 0 without events.

    Source: Garwood (1936), as `rate_upper`.
    """
    x = np.asarray(events)
    return np.where(x > 0, _chi_square(1 - confidence, 2 * np.maximum(x, 1), hours), 0.0)


def rate_interval(events: ArrayLike, hours: float, confidence: float = CONFIDENCE) -> tuple[Floats, Floats]:
    """Return the central interval of a Poisson rate, per hour.

    Source: Garwood (1936), as `rate_upper`.
    """
    each = (1 + confidence) / 2
    return rate_lower(events, hours, each), rate_upper(events, hours, each)


def share_upper(hits: ArrayLike, trials: int, confidence: float = CONFIDENCE) -> Floats:
    """Return the upper bound of a probability; 1 without trials. With k bad draws of N: of P(a draw is bad).

    Without hits it is 1 - (1 - confidence) ** (1 / trials).

    Source: Clopper and Pearson, The use of confidence or fiducial limits, Biometrika 26 (1934).
    """
    k = np.asarray(hits)
    bound = stats.beta.ppf(confidence, k + 1, np.maximum(trials - k, 1))
    return np.where(k < trials, bound, 1.0)


def share_lower(hits: ArrayLike, trials: int, confidence: float = CONFIDENCE) -> Floats:
    """Return the lower bound of a probability; 0 without hits. With k of n faults handled: of their coverage.

    Source: Clopper and Pearson (1934), as `share_upper`.
    """
    return 1.0 - share_upper(trials - np.asarray(hits), trials, confidence)


def share_interval(hits: ArrayLike, trials: int, confidence: float = CONFIDENCE) -> tuple[Floats, Floats]:
    """Return the central interval of a probability.

    Source: Clopper and Pearson (1934), as `share_upper`.
    """
    each = (1 + confidence) / 2
    return share_lower(hits, trials, each), share_upper(hits, trials, each)


def family_confidence(bounds: int, confidence: float = CONFIDENCE) -> float:
    """Return the confidence of each of several bounds for all to hold at once with `confidence`, however dependent.

    Source: Dunn, Multiple comparisons among means, J. Am. Stat. Assoc. 56 (1961), Bonferroni's inequality.
    """
    return 1 - (1 - confidence) / bounds


def further_hours(mtbf: float, events: int, hours: float, confidence: float = CONFIDENCE) -> float:
    """Return the further hours that show a mean time between events of at least `mtbf`; 0 if it is shown already.

    In total 3.00, 4.74, 6.30 and 10.5 times `mtbf` for 0, 1, 2 and 5 events at 95 %.

    Args:
        mtbf: h to show.
        events: total at the end: the present number if no further event occurs, twice it if as many occur again.
        hours: h so far.

    Source: Epstein and Sobel, Life testing, J. Am. Stat. Assoc. 48 (1953), solved for the time on test.
    """
    return max(0.0, mtbf * float(rate_upper(events, 1.0, confidence)) - hours)


def trials_needed(share: float, misses: int = 0, confidence: float = CONFIDENCE) -> int:
    """Return the least number of trials for `share_lower` to reach `share` with some misses: 59 for 95 %, 299 for 99 %.

    The number of the trial with the next miss is negative binomial.

    Args:
        share: required share of hits, below 1.

    Source: Wilks, Determination of sample sizes for setting tolerance limits, Ann. Math. Stat. 12 (1941).
    """
    return misses + 1 + int(stats.nbinom.ppf(confidence, misses + 1, 1 - share))


def _chi_square(probability: float, freedom: ArrayLike, hours: float) -> Floats:
    quantile = cast(Floats, stats.chi2.ppf(probability, freedom))
    return quantile / (2 * hours) if hours > 0 else np.full_like(quantile, np.inf)
