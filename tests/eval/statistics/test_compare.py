"""Two policies on the same draws: identities of the interval, what it says of whole soaks, and what it covers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.special import ndtri

from eval.judge.monitors import MONITORS
from eval.statistics import compare as compared
from eval.statistics.compare import paired_interval
from eval.statistics.dispersion import draw_rate_interval, draw_rate_upper
from eval.statistics.per_draw_counts import PerDrawCounts
from robots.errors import ConfigError
from robots.spec import load_robot
from support.arm6 import arm_judge

SPEC = load_robot("arm6")
NIGHT = np.full(16, 8.0)
TICKS = 8 * 3600 * 200
STUDY = 3_000
NOTHING = np.zeros(16)


def test_comparison_without_events_leaves_the_bound_of_zero_events():
    most = draw_rate_upper(NOTHING, NIGHT, 0.975)
    assert paired_interval((NOTHING, NIGHT), (NOTHING, NIGHT), 1.0) == (-most, most)


def test_against_a_policy_without_events_it_is_about_the_interval_of_the_other():
    events = np.random.default_rng(1).poisson(3.0, 16)
    low, high = paired_interval((NOTHING, NIGHT), (events, NIGHT), 1.0)
    alone = draw_rate_interval(events, NIGHT)
    most = draw_rate_upper(NOTHING, NIGHT, 0.975)
    assert alone[0] - most < low < alone[0]
    assert high == pytest.approx(alone[1])


amounts = st.lists(
    st.tuples(st.integers(0, 9), st.integers(0, 9), st.integers(0, 9)), min_size=2, max_size=20
)


@given(amounts, st.sampled_from([0.8, 0.95, 0.99]))
def test_comparison_is_antisymmetric_and_common_effects_cancel(rows, confidence):
    x, y, both = np.array(rows, dtype=np.float64).T
    hours = np.linspace(4, 8, len(x))
    low, high = paired_interval((x, hours), (y, hours), 1.0, confidence)
    assert low < ((y - x).sum() / hours.sum()) < high
    turned = paired_interval((y, hours), (x, hours), 1.0, confidence)
    assert turned == pytest.approx((-high, -low))
    shifted = paired_interval((x + both, hours), (y + both, hours), 1.0, confidence)
    assert shifted == pytest.approx((low, high))
    x_idle, y_idle, idle = (np.append(each, 0.0) for each in (x, y, hours))
    assert paired_interval((x_idle, idle), (y_idle, idle), 1.0, confidence) == pytest.approx((low, high))
    wider = paired_interval((x, hours), (y, hours), 1.0, (1 + confidence) / 2)
    assert wider[0] < low < high < wider[1]


def test_many_draws_give_student_t():
    rng = np.random.default_rng(2)
    x, y = rng.poisson(rng.gamma(2.0, 3.0, 20_000)), rng.poisson(rng.gamma(2.0, 2.0, 20_000))
    each = np.ones(20_000)
    expected = stats.ttest_rel(y, x).confidence_interval(0.95)
    found = paired_interval((x, each), (y, each), 1.0)
    assert found == pytest.approx((expected.low, expected.high), abs=0.1 * (expected.high - expected.low))


def soaked(seed, hard=0.0, missed=0.02, stops=0.0, robots=16):
    """A shift of robots in which events, goals missed and stops of ten minutes came by chance."""
    rng = np.random.default_rng(seed)
    counts = arm_judge(np.full(6, 100.0), robots).counts()
    counts.ticks[:] = TICKS
    counts.stops[:] = rng.poisson(stops, robots)
    counts.running[:] = TICKS - 120_000 * counts.stops
    counts.events[:, counts.columns("jerk")] = rng.poisson(hard / 6, (robots, 6))
    counts.events[:, counts.columns("tracking")] = 1000
    counts.attempted[:] = counts.due
    counts.reached[:] = rng.binomial(counts.attempted, 1 - missed)
    return counts


def compare(a, b):
    return compared.compare(*(PerDrawCounts.from_counts(counts) for counts in (a, b)))


@pytest.mark.parametrize(("factor", "kept"), [(1e300, 1e5), (-1e300, -273.15)])
def test_a_heat_beyond_any_is_kept_as_the_bound(factor, kept):
    """A winding without a guard may run away; the record of the soak can be read all the same."""
    counts = soaked(1)
    counts.worst[3, counts.columns("heat_hard")] = factor
    assert PerDrawCounts.from_counts(counts).hottest_c[3] == kept


def test_differences_match_the_reports():
    a, b = soaked(1, hard=2.0, stops=1.0), soaked(2, hard=1.0, missed=0.1, stops=0.2)
    goals, rate, availability = compare(a, b)
    assert (goals.a, goals.b) == pytest.approx((a.goal_success, b.goal_success))
    assert (availability.a, availability.b) == pytest.approx((a.availability, b.availability))
    hard = [sum(c.total(monitor.name) for monitor in MONITORS if monitor.hard) for c in (a, b)]
    assert (rate.a, rate.b) == pytest.approx((hard[0] / a.running_hours, hard[1] / b.running_hours))
    for each in (goals, rate, availability):
        assert each.low < each.b - each.a < each.high
        assert (each.draws, each.confidence) == (16, 0.95)
    assert [each.unit for each in (goals, rate, availability)] == ["", "1/h", ""]


def test_significant_differences_are_shown():
    worse = [each.conclusion for each in compare(soaked(1), soaked(2, hard=9.0, missed=0.2, stops=5.0))]
    better = [each.conclusion for each in compare(soaked(2, hard=9.0, missed=0.2, stops=5.0), soaked(1))]
    assert worse == ["lower", "higher", "lower"]
    assert better == ["higher", "lower", "higher"]
    assert {each.conclusion for each in compare(soaked(3, hard=1.0), soaked(4, hard=1.0))} == {
        "no difference"
    }


def test_same_soak_twice_shows_no_difference():
    for each in compare(soaked(1), soaked(1)):
        assert (each.differing, each.conclusion) == (0, "no difference")
        assert each.low == -each.high < 0


def test_draws_on_which_policies_differ_are_counted():
    a, b = soaked(1, hard=1.0), soaked(1, hard=1.0)
    b.events[[2, 5, 7], b.columns("self_collision")] += 1
    assert [each.differing for each in compare(a, b)] == [0, 3, 0]


def test_a_stop_that_was_not_seen_may_take_a_draw_and_one_like_those_seen_twice_its_length():
    unseen, seen = compare(soaked(1), soaked(1))[2], compare(soaked(1, stops=1.0), soaked(1, stops=1.0))[2]
    most = float(draw_rate_upper(NOTHING, np.ones(16), 0.975))
    assert unseen.high == pytest.approx(most)
    assert seen.high == pytest.approx(most / 24)


def test_a_share_differs_by_no_more_than_one():
    goals, _, availability = compare(soaked(1, robots=2), soaked(1, robots=2))
    assert (availability.low, availability.high) == (-1, 1)
    assert -1 < goals.low < goals.high < 1


def test_what_cannot_be_compared():
    with pytest.raises(ConfigError, match="robots: found 16 and 8 draws, expected the same draws"):
        compare(soaked(1), soaked(1, robots=8))
    idle = soaked(1)
    idle.running[:] = 0
    with pytest.raises(ConfigError, match="hard events: "):
        compare(soaked(1), idle)


def pairs(law, draws, rng):
    """Rates of `STUDY` soaks by both policies, each (n, STUDY) and 1 on average: alike, or χ²(1), of spread 2."""
    u, v = rng.random((2, draws, STUDY))
    if law == "alike":
        return np.ones_like(u), np.ones_like(u)
    other = {"same": u, "opposite": 1 - u, "unrelated": v}[law]
    return ndtri((1 + u) / 2) ** 2, ndtri((1 + other) / 2) ** 2


@pytest.mark.parametrize("expected", [3.7, 8, 300])
@pytest.mark.parametrize("ratio", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("draws", [16, 32])
@pytest.mark.parametrize("law", ["alike", "same", "opposite", "unrelated"])
def test_differences_of_rates_cover_what_they_promise(law, draws, ratio, expected):
    """A quarter of the draws stopped early, and all were under way for a little less by either policy."""
    rng = np.random.default_rng(3)
    h = np.r_[rng.uniform(0, 8, draws // 4), np.full(draws - draws // 4, 8.0)]
    h, g = h * rng.uniform(0.8, 1, (2, draws))
    rate = expected / h.sum()
    rates_a, rates_b = pairs(law, draws, rng)
    a, b = rng.poisson(rates_a * rate * h[:, None]), rng.poisson(rates_b * ratio * rate * g[:, None])
    low, high = paired_interval((a, h), (b, g), 1.0)
    assert np.mean((low <= (ratio - 1) * rate) & ((ratio - 1) * rate <= high)) >= 0.94


@pytest.mark.parametrize(("hit", "shape"), [(0.98, 0.5), (0.9, 2.0), (0.5, 5.0)])
def test_differences_of_goals_cover_what_they_promise(hit, shape):
    """Draws on which goals are missed by beta-binomial chance, of robots with unequal numbers of goals."""
    rng = np.random.default_rng(4)
    due = rng.integers(100, 7200, 16)
    chance = rng.beta(hit * shape / (1 - hit), shape, (16, STUDY))
    a, b = rng.binomial(due[:, None], chance), rng.binomial(due[:, None], chance**1.5)
    true = np.mean(rng.beta(hit * shape / (1 - hit), shape, 10**6) ** 1.5) - hit
    low, high = paired_interval((a, due), (b, due), 1.0)
    assert np.mean((low <= true) & (true <= high)) >= 0.94


@pytest.mark.parametrize("stops", [0.3, 1.0, 5.0])
def test_differences_of_availability_cover_what_they_promise(stops):
    """Stops by gamma-mixed chance, each of ten minutes on average and of any length, by one policy twice as many."""
    rng = np.random.default_rng(5)
    rates = rng.gamma(0.5, 2.0, (16, STUDY)) * stops
    down = [
        rng.gamma(np.maximum(many, 1e-9)) * 120_000 for many in (rng.poisson(rates), rng.poisson(2 * rates))
    ]
    ticks = np.full(16, float(TICKS))
    low, high = paired_interval((TICKS - down[0], ticks), (TICKS - down[1], ticks), 240_000)
    true = -stops * 120_000 / TICKS
    assert np.mean((low <= true) & (true <= high)) >= 0.94


def test_students_t_would_promise_too_much():
    rng = np.random.default_rng(6)
    events = rng.poisson(20 * rng.gamma(0.5, 2.0, (16, STUDY)))
    found = stats.ttest_1samp(events, 20).pvalue
    assert np.mean(found >= 0.05) < 0.9
