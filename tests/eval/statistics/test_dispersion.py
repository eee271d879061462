"""Draws that differ: exact tests, tails of the negative binomial, and studies of what bounds over draws promise."""

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from eval.statistics import dispersion
from eval.statistics.dispersion import dispersion_p, draw_rate_interval, draw_rate_lower, draw_rate_upper
from eval.statistics.evidence import rate_interval, rate_lower, rate_upper

NIGHT = np.full(16, 8.0)
STUDY = 4_000


def index(x, share):
    """Fisher's index of dispersion over the last axis."""
    mean = x.sum(axis=-1, keepdims=True) * share
    return ((x - mean) ** 2 / mean).sum(axis=-1)


@pytest.mark.parametrize("spread", [0.0, 0.02, 0.1])
def test_with_many_events_the_index_is_chi_square(spread):
    rng = np.random.default_rng(1)
    hours = rng.uniform(4, 8, 32)
    events = rng.poisson(20 * hours * rng.normal(1, spread, 32))
    expected = stats.chi2.sf(index(events, hours / hours.sum()), 31)
    assert dispersion_p(events, hours) == pytest.approx(expected, abs=0.015)


@pytest.mark.parametrize("events", [(4, 0, 0), (2, 2, 0), (0, 1, 3), (1, 3, 0), (2, 1, 1)])
def test_with_few_events_it_is_the_sum_over_all_that_could_have_been(events):
    hours = np.array([8.0, 7.0, 1.0])
    share = hours / hours.sum()
    possible = np.array([x for x in product(range(5), repeat=3) if sum(x) == 4])
    as_odd = index(possible, share) >= index(np.array(events), share) - 1e-9
    expected = stats.multinomial.pmf(possible[as_odd], 4, share).sum()
    assert dispersion_p(events, hours) == pytest.approx(expected, abs=0.015)


def test_equal_draws_are_rarely_called_different(monkeypatch):
    monkeypatch.setattr(dispersion, "RESAMPLES", 199)
    rng = np.random.default_rng(2)
    hours = rng.uniform(0.5, 8, 16)
    found = [dispersion_p(rng.poisson(0.06 * hours), hours) for _ in range(1_000)]
    assert 0.01 < np.mean(np.array(found) <= 0.05) <= 0.06


def test_many_draws_get_fewer_samples(monkeypatch):
    hours, events = np.ones(64), np.repeat((0, 4), 32)
    assert dispersion_p(events, hours) == pytest.approx(1 / 10_000)
    monkeypatch.setattr(dispersion, "RESAMPLED_MAX", 64 * 199)
    assert dispersion_p(events, hours) == pytest.approx(1 / 200)
    assert dispersion_p(events, hours, 2 * 64) == pytest.approx(1 / 100)


def test_different_draws_are_found():
    rng = np.random.default_rng(3)
    rates = rng.gamma(0.5, 2.0, (9, 32))
    assert np.median([dispersion_p(rng.poisson(5 * rate), np.ones(32)) for rate in rates]) < 1e-3


@pytest.mark.parametrize("events", [(0, 0, 0), (1, 0, 0)])
def test_too_few_events_show_nothing(events):
    assert dispersion_p(events, (8, 8, 8)) == 1.0


def test_the_test_repeats_has_no_unit_and_asks_no_draw_without_hours():
    events, hours = np.array([5, 0, 1, 0, 2]), np.array([8.0, 8.0, 3.0, 8.0, 0.0])
    found = dispersion_p(events, hours)
    assert found == dispersion_p(events, hours) == dispersion_p(events, 2 * hours)
    assert found == dispersion_p(events[:4], hours[:4])
    assert dispersion_p(events, np.zeros(5)) == 1.0


@pytest.mark.parametrize(("draws", "factor"), [(16, 3.63), (64, 3.14), (10_000, 3.00)])
def test_without_events_draws_may_still_differ(draws, factor):
    hours = np.full(draws, 8.0)
    mean = float(draw_rate_upper(np.zeros(draws), hours)) * hours.sum()
    assert mean == pytest.approx(factor, abs=5e-3)
    assert stats.nbinom.cdf(0, draws / 2, draws / 2 / (draws / 2 + mean)) == pytest.approx(0.05)
    assert draw_rate_lower(np.zeros(draws), hours) == 0


@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_bounds_are_where_the_negative_binomial_tail_is_five_percent(confidence):
    events = np.r_[np.zeros(12), 30, 2, 50, 1]
    r = (
        16 * events.mean() ** 2 / (events.var(ddof=1) - events.mean())
    )  # the spread by moments is above UNSEEN
    assert r < 16 / dispersion.UNSEEN

    def law(bound):
        return stats.nbinom(r, r / (r + bound(events, NIGHT, confidence) * NIGHT.sum()))

    assert law(draw_rate_upper).cdf(events.sum()) == pytest.approx(1 - confidence)
    assert law(draw_rate_lower).sf(events.sum() - 1) == pytest.approx(1 - confidence)


def test_events_as_even_as_hours_give_the_bounds_of_hours():
    events, hours = np.repeat([40, 10], 8), np.repeat([8.0, 2.0], 8)
    found, expected = draw_rate_interval(events, hours), rate_interval(400, hours.sum())
    assert np.array(found) == pytest.approx(np.array(expected), rel=1e-6)


night = st.lists(st.tuples(st.integers(0, 30), st.floats(0.1, 8)), min_size=2, max_size=40)
sure = st.sampled_from([0.8, 0.9, 0.95, 0.99, 0.999])


@given(night, sure)
def test_bounds_are_never_tighter_than_those_of_hours(draws, confidence):
    events, hours = np.array(draws).T
    total, exposure = events.sum(), hours.sum()
    assert draw_rate_upper(events, hours, confidence) >= rate_upper(total, exposure, confidence) * (1 - 1e-6)
    assert draw_rate_lower(events, hours, confidence) <= rate_lower(total, exposure, confidence) * (1 + 1e-6)


@given(night, sure, st.integers(2, 100))
def test_bounds_have_a_unit_and_no_order(draws, confidence, scale):
    events, hours = np.array(draws).T
    found = np.array(draw_rate_interval(events, hours, confidence))
    for same in ((events[::-1], hours[::-1]), (np.r_[events, 0], np.r_[hours, 0])):
        assert np.array(draw_rate_interval(*same, confidence)) == pytest.approx(found)
    assert np.array(draw_rate_interval(events, scale * hours, confidence)) == pytest.approx(found / scale)
    low, high = draw_rate_interval(events, hours, (1 + confidence) / 2)
    assert low <= found[0] * (1 + 1e-9)
    assert high >= found[1] * (1 - 1e-9)


@given(night)
def test_pooled_nights_narrow_the_bounds(draws):
    events, hours = np.array(draws).T
    once, thrice = draw_rate_upper(events, hours), draw_rate_upper(np.tile(events, 3), np.tile(hours, 3))
    assert thrice < once


def test_many_monitors_at_once_are_as_one_by_one():
    events = np.random.default_rng(4).poisson(0.5, (16, 3))
    one_by_one = np.array([draw_rate_interval(column, NIGHT) for column in events.T])
    assert np.transpose(draw_rate_interval(events, NIGHT)) == pytest.approx(one_by_one)


def test_one_draw_gives_wide_bounds_and_none_gives_none():
    assert draw_rate_upper([0], [8.0]) * 8 == pytest.approx(199.5)
    assert draw_rate_upper([7], [8.0]) > 100
    assert draw_rate_interval([0, 3], [0.0, 0.0]) == (0, math.inf)


RATES = {
    "alike": lambda rng, n: np.ones((n, STUDY)),
    "spread 1/2": lambda rng, n: rng.gamma(2.0, 1 / 2, (n, STUDY)),
    "spread 1": lambda rng, n: rng.gamma(1.0, 1.0, (n, STUDY)),
    "spread 2": lambda rng, n: rng.gamma(0.5, 2.0, (n, STUDY)),
}


def soaks(rates, draws, expected, seed=5):
    """`STUDY` soaks in which a quarter of the robots stopped early: events, hours, the rate that holds for all."""
    rng = np.random.default_rng(seed)
    hours = np.r_[np.full(draws - draws // 4, 8.0), rng.uniform(0, 8, draws // 4)]
    rate = expected / hours.sum()
    return rng.poisson(RATES[rates](rng, draws) * rate * hours[:, None]), hours, rate


@pytest.mark.parametrize("expected", [3.7, 6.4, 12, 300])
@pytest.mark.parametrize("draws", [16, 32, 64])
@pytest.mark.parametrize("rates", RATES)
def test_bounds_over_draws_cover_what_they_promise(rates, draws, expected):
    events, hours, rate = soaks(rates, draws, expected)
    low, high = draw_rate_interval(events, hours)
    assert np.mean((low <= rate) & (rate <= high)) >= 0.94
    assert np.mean(rate <= draw_rate_upper(events, hours)) >= 0.94
    assert np.mean(draw_rate_lower(events, hours) <= rate) >= 0.94


@pytest.mark.parametrize("expected", [3.7, 12, 300])
def test_family_of_bounds_over_draws_has_joint_coverage(expected):
    """Fourteen monitors with one set of hours, each on draws of its own."""
    each = 1 - 0.05 / 14
    events, hours, rate = soaks("spread 2", 16, expected)
    assert np.mean(rate <= draw_rate_upper(events, hours, each)) >= 1 - 0.06 / 14


def test_choosing_by_the_test_loses_coverage():
    events, hours, rate = soaks("spread 2", 16, 12)
    by_hours, by_draws = rate_interval(events.sum(axis=0), hours.sum()), draw_rate_interval(events, hours)
    p = stats.chi2.sf(index(np.where(events.any(axis=0), events, 1).T, hours / hours.sum()), 15)
    low, high = np.where(p < 0.05, by_draws, by_hours)
    assert 0.8 < np.mean((low <= rate) & (rate <= high)) < 0.91


@pytest.mark.parametrize(("method", "most"), [("percentile", 0.88), ("BCa", 0.9)])
def test_bootstrap_over_draws_loses_coverage(method, most):
    events, rate = np.random.default_rng(6).poisson(20 * RATES["spread 2"](np.random.default_rng(7), 16)), 20
    found = stats.bootstrap(
        (events[:, :1_000],), np.mean, axis=0, n_resamples=499, batch=50, method=method, rng=8
    ).confidence_interval
    assert 0.8 < np.mean((found.low <= rate) & (rate <= found.high)) < most


def test_a_spread_beyond_the_promise_is_not_covered():
    """What the module says it cannot do: bad draws of a kind that most nights hold none of."""
    rng = np.random.default_rng(9)
    rates = np.where(rng.random((16, STUDY)) < 0.1, 10.0, 1.0)
    assert np.mean(draw_rate_upper(rng.poisson(10 * rates), NIGHT) >= 19 / 8) < 0.85
