"""Numbers in report.json: rounding, medians and formatting."""

import math
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from robots.arrays import Floats

Count = Annotated[int, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
# None replaces NaN and infinity: no exposure, a diverged simulation.
Number = float | None


def number(value: ArrayLike, digits: int | None = None) -> Number:
    """Return a finite number, rounded if `digits` is given; None if not finite."""
    value = float(np.asarray(value))
    return (value if digits is None else round(value, digits)) if math.isfinite(value) else None


def series(values: Floats, digits: int) -> tuple[Number, ...]:
    """Return `number` of each element of (T,)."""
    return tuple(number(value, digits) for value in values)


def median(values: Floats) -> Floats:
    """Return the median (T, ...) over finite values of (T, N, ...); NaN if there are none."""
    return np.asarray(np.ma.median(np.ma.masked_invalid(values), axis=1).filled(np.nan))


def figure(value: float | None, digits: int = 3) -> str:
    """Format a number with some significant digits and thousands separators; `–` for None."""
    if value is None:
        return "–"
    if abs(value) >= 10**digits or value == int(value):
        return f"{value:,.0f}"
    return np.format_float_positional(float(f"{value:.{digits}g}"), trim="-")
