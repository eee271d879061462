"""Two policies on the same draws: by how much they differ, and how sure of it we may be.

Draw by draw, what the second policy has more of is told from what it has less of. Both are amounts that are
never negative, come in lumps and differ between draws as events do, so `eval.statistics.dispersion` bounds both, and
the two intervals make that of the difference. What a draw does to both policies alike cancels. Student's t on the
same differences misses what is skewed, and calls a difference impossible that merely was not seen.

What a nominal 95 % covers, at 16 to 64 draws whose rates have a spread up to 2 and are the same for both
policies, proportional, opposite or unrelated: 94 % and more, and 93 % where each policy had the robots of another
quarter of 16 draws stop early. Student's t covers 88 % if one policy has no events. The price is width: at 16
draws some 1.5 times that of Student's t, at 64 draws 1.2 times.
"""

from dataclasses import dataclass

import numpy as np

from eval.statistics.dispersion import draw_rate_interval
from eval.statistics.evidence import CONFIDENCE
from eval.statistics.per_draw_counts import Ratio, Tally, stop_ticks
from robots.arrays import Floats
from robots.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """One number of two policies, and the interval of `b` less `a` at `confidence`.

    Attributes:
        unit: of `a`, `b`, `low` and `high`; empty for a share.
        draws, differing: on which both ran, and of these on which they are not equal.
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
    def shown(self) -> str:
        """What the interval shows of `b` beside `a`."""
        if self.low > 0:
            return "higher"
        return "lower" if self.high < 0 else "no difference"


def compare(a: Tally, b: Tally, confidence: float = CONFIDENCE) -> tuple[Difference, ...]:
    """Goals reached ÷ due, hard events per hour under way, and availability.

    Args:
        a, b: draw by draw the same; that they are is `pooling.same_draws`'s to see to.

    Raises:
        ConfigError: not as many draws, or one of the policies never was at it.
    """
    if a.draws != b.draws:
        raise ConfigError(f"robots: {a.draws} and {b.draws} are not the same draws")
    # Where no stop was seen, one may take all of its draw.
    stop = stop_ticks(a, b) or float(max(a.ticks))
    return (
        _difference("goals reached", "", a.goals, b.goals, 1.0, confidence),
        _difference("hard events", "1/h", a.hard_events, b.hard_events, 1.0, confidence),
        _difference("availability", "", a.under_way, b.under_way, stop, confidence),
    )


def _difference(name: str, unit: str, a: Ratio, b: Ratio, lump: float, confidence: float) -> Difference:
    for amount, exposure in (a, b):
        if not exposure.sum() > 0:
            raise ConfigError(f"{name}: {amount.sum():g} in no time at all cannot be compared")
    low, high = paired_interval(a, b, lump, confidence)
    most = np.inf if unit else 1.0
    return Difference(
        name=name,
        unit=unit,
        a=float(a[0].sum() / a[1].sum()),
        b=float(b[0].sum() / b[1].sum()),
        low=max(-most, float(low)),
        high=min(most, float(high)),
        confidence=confidence,
        draws=len(a[0]),
        differing=int((a[0] * b[1] != b[0] * a[1]).sum()),
    )


def paired_interval(a: Ratio, b: Ratio, lump: float, confidence: float = CONFIDENCE) -> tuple[Floats, Floats]:
    """Central interval of Σ amounts ÷ Σ exposures of `b`, less the same of `a`.

    Args:
        a, b: (n, ...) amounts and (n,) exposures, draw by draw the same draw.
        lump: amount that comes at once, 1 for events: one that was not seen may have been due.
        confidence: of both sides.

    Source: Zou and Donner, Construction of confidence limits about effect measures, Stat. Med. 27 (2008):
    the limits of a difference from those of its correlated parts.
    """
    (x, h), (y, g) = a, b
    each = y / g.sum() - x / h.sum()
    weight = (h / h.sum() + g / g.sum()) / 2
    lump = lump / min(h.sum(), g.sum())
    parts = np.stack((np.maximum(each, 0), np.maximum(-each, 0)), axis=1) / lump
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
