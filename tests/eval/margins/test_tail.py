"""Levels of maxima against closed forms."""

import numpy as np
import pytest
from scipy.stats import gumbel_r, norm

from eval.margins.tail import level


def test_level_of_a_gumbel_sample_is_its_quantile():
    maxima = gumbel_r.rvs(0.1, 0.02, size=100_000, random_state=1)
    for probability in (1e-2, 1e-9):
        assert level(maxima, probability) == pytest.approx(gumbel_r.isf(probability, 0.1, 0.02), rel=0.01)


def test_level_of_maxima_of_normal_noise_is_on_the_safe_side_by_little():
    values, probability = 2000, 1e-8
    maxima = norm.rvs(size=(500, values), random_state=2).max(axis=1)
    exact = norm.isf(probability / values)
    assert exact < level(maxima, probability) < 1.4 * exact


def test_maxima_without_spread_are_their_own_level():
    assert level(np.full(20, 0.3), 1e-9) == pytest.approx(0.3)
