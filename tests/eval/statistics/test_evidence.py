"""Bounds against published figures, closed forms, and a simulation study of what they promise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from eval.statistics import evidence


def test_no_events_is_the_rule_of_three():
    assert evidence.rate_upper(0, 8.0) == pytest.approx(-np.log(0.05) / 8)
    assert evidence.rate_upper(0, 8.0) == pytest.approx(0.374, abs=5e-4)
    assert evidence.rate_lower(0, 8.0) == 0


@pytest.mark.parametrize(("events", "hours"), [(0, 3.00), (1, 4.74), (2, 6.30), (5, 10.5)])
def test_hours_that_show_one_failure_an_hour(events, hours):
    """The exposure factors that reliability tables print at 95 %."""
    assert evidence.rate_upper(events, hours) == pytest.approx(1.0, abs=5e-3)


@pytest.mark.parametrize("events", [1, 3, 20])
def test_rate_bounds_are_where_the_poisson_tail_is_five_percent(events):
    assert stats.poisson.cdf(events, evidence.rate_upper(events, 2.0) * 2.0) == pytest.approx(0.05)
    assert stats.poisson.sf(events - 1, evidence.rate_lower(events, 2.0) * 2.0) == pytest.approx(0.05)


@pytest.mark.parametrize(("draws", "bound"), [(16, 0.17), (64, 0.046), (299, 0.01)])
def test_no_bad_draw(draws, bound):
    assert evidence.share_upper(0, draws) == pytest.approx(1 - 0.05 ** (1 / draws))
    assert evidence.share_upper(0, draws) == pytest.approx(bound, abs=1e-3)


@pytest.mark.parametrize(("hits", "trials"), [(1, 16), (5, 16), (900, 1000)])
def test_share_bounds_are_where_the_binomial_tail_is_five_percent(hits, trials):
    assert stats.binom.cdf(hits, trials, evidence.share_upper(hits, trials)) == pytest.approx(0.05)
    assert stats.binom.sf(hits - 1, trials, evidence.share_lower(hits, trials)) == pytest.approx(0.05)


def test_intervals_equal_scipys_own():
    found = stats.binomtest(37, 40).proportion_ci(method="exact")
    assert evidence.share_interval(37, 40) == pytest.approx((found.low, found.high))
    low, high = evidence.rate_interval(4, 2.0)
    assert (2 * low, 2 * high) == pytest.approx((1.0899, 10.2416), abs=1e-4)  # Garwood's table, 4 events


def test_no_exposure_allows_every_rate_and_share():
    assert evidence.rate_interval(0, 0.0) == (0, np.inf)
    assert evidence.share_interval(0, 0) == (0, 1)
    assert evidence.share_upper(16, 16) == 1


STUDY = 20_000


@pytest.mark.parametrize(("rate", "hours"), [(0.02, 8), (0.3, 8), (0.3, 128), (2.0, 128)])
def test_rate_intervals_have_the_nominal_coverage(rate, hours):
    events = np.random.default_rng(1).poisson(rate * hours, size=STUDY)
    low, high = evidence.rate_interval(events, hours)
    assert np.mean((low <= rate) & (rate <= high)) >= 0.94
    assert np.mean(rate <= evidence.rate_upper(events, hours)) >= 0.94
    assert np.mean(evidence.rate_lower(events, hours) <= rate) >= 0.94


@pytest.mark.parametrize(("share", "trials"), [(0.03, 16), (0.2, 64), (0.97, 900), (0.5, 20)])
def test_share_intervals_have_the_nominal_coverage(share, trials):
    hits = np.random.default_rng(2).binomial(trials, share, size=STUDY)
    low, high = evidence.share_interval(hits, trials)
    assert np.mean((low <= share) & (share <= high)) >= 0.94
    assert np.mean(share <= evidence.share_upper(hits, trials)) >= 0.94
    assert np.mean(evidence.share_lower(hits, trials) <= share) >= 0.94


@pytest.mark.parametrize("interval", [evidence.rate_interval, evidence.share_interval])
def test_more_trials_narrow_the_interval(interval):
    widths = [high - low for low, high in (interval(k, 10 * k) for k in (1, 4, 16, 64))]
    assert widths == sorted(widths, reverse=True)


@given(st.integers(0, 500), st.integers(1, 50), st.floats(0.1, 1e4), st.floats(1.01, 10))
def test_rate_bounds_rise_with_events_and_fall_with_hours(events, more, hours, longer):
    for bound in (evidence.rate_upper, evidence.rate_lower):
        assert bound(events + more, hours) > bound(events, hours)
        assert bound(events + more, hours * longer) < bound(events + more, hours)
    assert evidence.rate_lower(events, hours) <= events / hours < evidence.rate_upper(events, hours)


@pytest.mark.parametrize("rates", [np.full(14, 0.3), np.geomspace(0.1, 10, 14)])
def test_family_of_bounds_has_joint_coverage(rates):
    """Fourteen monitors, of which the second half has the events of the first."""
    draws = np.random.default_rng(3).poisson(rates * 128, size=(STUDY, 14))
    draws[:, 7:], rates = draws[:, :7], np.tile(rates[:7], 2)
    each = evidence.family_confidence(14)
    assert np.mean((rates <= evidence.rate_upper(draws, 128, each)).all(axis=1)) >= 0.95
    assert np.mean((rates <= evidence.rate_upper(draws, 128)).all(axis=1)) < 0.9


def test_a_family_of_one_needs_no_more_than_itself():
    assert evidence.family_confidence(1) == pytest.approx(evidence.CONFIDENCE)
    assert evidence.family_confidence(10, 0.9) == pytest.approx(0.99)


@pytest.mark.parametrize(("events", "factor"), [(0, 3.00), (1, 4.74), (2, 6.30), (5, 10.5)])
def test_further_hours_for_a_wanted_time_between_events(events, factor):
    assert evidence.further_hours(100.0, events, 0.0) == pytest.approx(100 * factor, rel=2e-3)
    assert evidence.further_hours(100.0, events, 128.0) == pytest.approx(100 * factor - 128, abs=2.0)


@given(st.floats(1, 1e4), st.integers(0, 20), st.floats(0, 1e4), st.sampled_from([0.9, 0.95, 0.99]))
def test_further_hours_are_enough_and_none_too_many(mtbf, events, hours, confidence):
    more = evidence.further_hours(mtbf, events, hours, confidence)
    shown = evidence.rate_upper(events, hours + more, confidence) * mtbf
    assert shown == pytest.approx(1.0) if more > 0 else shown <= 1.0


@pytest.mark.parametrize(("share", "trials"), [(0.90, 29), (0.95, 59), (0.99, 299), (0.999, 2995)])
def test_trials_that_all_succeed(share, trials):
    """The sample sizes of 95 % tolerance limits, as tables print them."""
    assert evidence.trials_needed(share) == trials
    assert evidence.share_lower(trials, trials) >= share > evidence.share_lower(trials - 1, trials - 1)


@pytest.mark.parametrize("misses", [0, 1, 2, 5])
@pytest.mark.parametrize("share", [0.5, 0.8, 0.95, 0.99])
@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_needed_trials_are_the_least_that_reach_the_share(misses, share, confidence):
    trials = evidence.trials_needed(share, misses, confidence)
    assert evidence.share_lower(trials - misses, trials, confidence) >= share
    assert evidence.share_lower(trials - 1 - misses, trials - 1, confidence) < share
