"""Comparison of two policies on the same draws: differences and their confidence intervals.

Positive and negative differences are summed separately over the draws. Both sums are non-negative amounts that come
in lumps and vary between draws as events do, so `eval.statistics.dispersion` bounds each of them, and the interval of
the difference follows from both. Effects of a draw on both policies cancel. Student's t on the same differences
ignores skewness, and gives a zero interval where no difference was observed.

Actual coverage of a nominal 95 % interval, with 16 to 64 draws whose rates have a spread up to 2 and are the same for
both policies, proportional, opposite or unrelated: 94 % and more; 93 % where each policy makes the robots of another
quarter of 16 draws stop early. Student's t covers 88 % if one policy has no events. The interval is wider: 1.5 times
that of Student's t at 16 draws, 1.2 times at 64 draws.
"""

from dataclasses import dataclass

import numpy as np

from eval.statistics.dispersion import draw_rate_interval
from eval.statistics.evidence import CONFIDENCE
from eval.statistics.per_draw_counts import PerDrawCounts, Ratio, stop_ticks
from robots.arrays import Floats
from robots.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """One quantity of two policies, and the interval of b - a at `confidence`.

    Attributes:
        unit: of `a`, `b`, `low` and `high`; empty for a share.
        draws: number of draws. differing: number of those on which the policies are not equal.
    """

    name: str
    unit: str
    a: float
    b: float
    low: float
    high: float
    confidence: float
    draws: int
    differing: int

    @property
    def conclusion(self) -> str:
        """Conclusion of the interval about `b` relative to `a`: "higher", "lower" or "no difference"."""
        if self.low > 0:
            return "higher"
        return "lower" if self.high < 0 else "no difference"


def compare(a: PerDrawCounts, b: PerDrawCounts, confidence: float = CONFIDENCE) -> tuple[Difference, ...]:
    """Compare goals reached ÷ due, hard events per hour of operating time, and availability on the same draws.

    Raises:
        ConfigError: the numbers of draws differ, or a policy has no exposure.
    """
    if a.draws != b.draws:
        raise ConfigError(f"robots: found {a.draws} and {b.draws} draws, expected the same draws")
    # Without an observed stop, a stop may take the whole time of its draw.
    stop = stop_ticks(a, b) or float(max(a.ticks))
    return (
        _difference("goals reached", "", a.goals, b.goals, 1.0, confidence),
        _difference("hard events", "1/h", a.hard_events, b.hard_events, 1.0, confidence),
        _difference("availability", "", a.availability, b.availability, stop, confidence),
    )


def _difference(name: str, unit: str, a: Ratio, b: Ratio, lump: float, confidence: float) -> Difference:
    for amount, exposure in (a, b):
        if not exposure.sum() > 0:
            raise ConfigError(f"{name}: found no exposure ({amount.sum():g} counted), expected more than 0")
    low, high = paired_interval(a, b, lump, confidence)
    bound = np.inf if unit else 1.0
    return Difference(
        name=name,
        unit=unit,
        a=float(a[0].sum() / a[1].sum()),
        b=float(b[0].sum() / b[1].sum()),
        low=max(-bound, float(low)),
        high=min(bound, float(high)),
        confidence=confidence,
        draws=len(a[0]),
        differing=int((a[0] * b[1] != b[0] * a[1]).sum()),
    )


def paired_interval(a: Ratio, b: Ratio, lump: float, confidence: float = CONFIDENCE) -> tuple[Floats, Floats]:
    """Return the central interval of Σ amounts ÷ Σ exposures of `b` minus that of `a`.

    Args:
        a, b: (n, ...) amounts and (n,) exposures, of the same draws in the same order.
        lump: amount of one occurrence, 1 for events; one that was not observed may have been due.
        confidence: two-sided.

    Source: Zou and Donner, Construction of confidence limits about effect measures, Stat. Med. 27 (2008):
    the limits of a difference from those of its correlated parts.
    """
    (x, h), (y, g) = a, b
    difference = y / g.sum() - x / h.sum()
    weight = (h / h.sum() + g / g.sum()) / 2
    lump = lump / min(h.sum(), g.sum())
    parts = np.stack((np.maximum(difference, 0), np.maximum(-difference, 0)), axis=1) / lump
    more, less = parts.sum(axis=0)
    (more_low, less_low), (more_high, less_high) = draw_rate_interval(parts, weight, confidence)
    rest = parts - np.multiply.outer(weight, parts.sum(axis=0))
    norms = np.sqrt((rest**2).sum(axis=0).prod(axis=0))
    r = rest.prod(axis=1).sum(axis=0) / np.where(norms > 0, norms, 1.0)
    down = _hypotenuse(more - more_low, less_high - less, r)
    up = _hypotenuse(more_high - more, less - less_low, r)
    return lump * (more - less - down), lump * (more - less + up)


def _hypotenuse(p: Floats, q: Floats, r: Floats) -> Floats:
    return np.sqrt(p**2 + q**2 - 2 * r * p * q)
