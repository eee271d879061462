"""Numbers as report.json holds them."""

import math
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from robots.arrays import Floats

Count = Annotated[int, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
# None stands for a number that is none: no exposure, a NaN, a diverged simulation.
Number = float | None


def number(value: ArrayLike, digits: int | None = None) -> Number:
    """A finite number, rounded if `digits` says so; None for any other."""
    value = float(np.asarray(value))
    return (value if digits is None else round(value, digits)) if math.isfinite(value) else None


def series(values: Floats, digits: int) -> tuple[Number, ...]:
    """`number` of each of (T,)."""
    return tuple(number(value, digits) for value in values)


def median(values: Floats) -> Floats:
    """(T, ...) of what is known of the robots of (T, N, ...), NaN for nothing."""
    return np.asarray(np.ma.median(np.ma.masked_invalid(values), axis=1).filled(np.nan))


def figure(value: float | None, digits: int = 3) -> str:
    """A number to some digits, thousands apart, and `–` for one that is none."""
    if value is None:
        return "–"
    if abs(value) >= 10**digits or value == int(value):
        return f"{value:,.0f}"
    return np.format_float_positional(float(f"{value:.{digits}g}"), trim="-")
