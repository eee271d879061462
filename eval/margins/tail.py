"""Level that the largest value of a trial passes no more often than a given rate.

Source: Coles, An Introduction to Statistical Modeling of Extreme Values (2001), 3.1.2: maxima of many values whose tail
is that of a normal distribution have a Gumbel distribution. Hosking, L-Moments (1990), table 2: its parameters.
"""

import numpy as np
from scipy.stats import gumbel_r, lmoment

from robots.arrays import Floats


def level(maxima: Floats, probability: float) -> float:
    """Return the level that the maximum (N,) of one of N trials passes with a probability."""
    first, second = lmoment(maxima, order=[1, 2])
    scale = second / np.log(2.0)
    return float(gumbel_r.isf(probability, first - np.euler_gamma * scale, scale))
