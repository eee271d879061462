"""Which parameters explain failures: chance alone names none, and what is planted is found."""

import numpy as np
import pytest
from scipy import stats

from eval.statistics.sensitivity import correlate, parameter_values
from robots.distributions import load_distributions
from robots.draws import draw
from robots.randomness import robot_seed
from robots.spec import load_robot

SPEC = load_robot("arm6")
DISTRIBUTIONS = load_distributions(SPEC)
NIGHTS, RESAMPLES = 200, 199


def columns(values, letter):
    return {f"{letter}{k}": column for k, column in enumerate(values.T)}


def night(rng, draws, many=30):
    """Parameters and three outcomes that have nothing to do with them: one of counts mostly 0, two that go together."""
    common = rng.normal(size=draws)
    outcomes = np.stack((rng.poisson(0.3, draws), common, common + rng.normal(size=draws)), axis=1)
    return columns(rng.uniform(size=(draws, many)), "x"), columns(outcomes.astype(float), "y")


@pytest.mark.parametrize("draws", [16, 64])
@pytest.mark.slow
def test_chance_names_a_parameter_no_more_often_than_alpha(draws):
    rng = np.random.default_rng(3)
    named = 0
    for _ in range(NIGHTS):
        found = correlate(*night(rng, draws), RESAMPLES)
        named += found.correlations[0].p <= 0.05
    # 10 of 200 are to be expected, 3.1 their standard deviation.
    assert 3 <= named <= 19


def test_planted_effect_is_found_among_many_parameters():
    rng, hits = np.random.default_rng(4), 0
    for _ in range(30):
        given, outcomes = night(rng, 32)
        outcomes["y1"] = 2 * stats.norm.ppf(given["x7"]) + rng.normal(size=32)
        best = correlate(given, outcomes, RESAMPLES).correlations[0]
        hits += (best.parameter, best.outcome) == ("x7", "y1") and best.p <= 0.05
        assert best.rho > 0
    assert hits >= 28


def test_correlations_equal_spearman_with_ties():
    given, outcomes = night(np.random.default_rng(5), 20)
    for pair in correlate(given, outcomes, 1).correlations:
        oracle = stats.spearmanr(given[pair.parameter], outcomes[pair.outcome])
        assert pair.rho == pytest.approx(oracle.statistic, abs=1e-12)


def test_p_value_of_one_pair_equals_a_permutation_test():
    x, y = np.arange(5.0), np.array([0.0, 2.0, 1.0, 3.0, 4.0])
    # |rho| >= 0.9 in 10 of the 120 orders: itself, four exchanges of neighbours, and these reversed.
    assert correlate({"x": x}, {"y": y}, 9999).correlations[0].p == pytest.approx(10 / 120, abs=0.01)


def test_outcomes_of_a_draw_are_permuted_together():
    """Copies of an outcome are no further chances, as they would be if each were permuted by itself."""
    rng = np.random.default_rng(8)
    given, y = columns(rng.uniform(size=(24, 3)), "x"), rng.normal(size=24)
    one, many = (correlate(given, columns(np.tile(y[:, None], k), "y"), RESAMPLES) for k in (1, 12))
    p = {pair.parameter: pair.p for pair in one.correlations}
    assert min(p.values()) < 0.9
    assert len(many.correlations) == 12 * len(p)
    assert all(pair.p == p[pair.parameter] for pair in many.correlations)
    assert many.noticeable == pytest.approx(one.noticeable, abs=1e-9)


def test_noticeable_means_small_p_value():
    given, outcomes = night(np.random.default_rng(6), 16)
    found = correlate(given, outcomes, RESAMPLES)
    strongest = found.correlations[0]
    assert (abs(strongest.rho) >= found.noticeable) == (strongest.p <= 0.05)
    given["x0"] = outcomes["y1"]
    found = correlate(given, outcomes, RESAMPLES)
    assert found.correlations[0].rho == pytest.approx(1.0)
    assert all((abs(pair.rho) >= found.noticeable) == (pair.p <= 0.05) for pair in found.correlations)
    assert 0.6 < found.noticeable < 0.9


def test_more_draws_make_smaller_effects_noticeable():
    few, many = (correlate(*night(np.random.default_rng(7), n), RESAMPLES).noticeable for n in (16, 256))
    assert few > 2 * many


def test_constant_parameter_explains_nothing():
    given = {"a": np.arange(9.0), "b": np.ones(9)}
    found = correlate(given, {"up": np.arange(9.0), "never": np.zeros(9)}, RESAMPLES)
    assert (found.parameters, found.outcomes, len(found.correlations)) == (("a",), ("up",), 1)
    nothing = correlate(given, {"never": np.zeros(9)})
    assert (nothing.outcomes, nothing.correlations, nothing.noticeable) == ((), (), np.inf)


@pytest.mark.parametrize("draws", [1, 2, 3])
def test_few_draws_show_nothing(draws):
    found = correlate({"a": np.arange(float(draws))}, {"b": np.arange(float(draws))})
    assert all(pair.p > 0.3 for pair in found.correlations)
    assert found.noticeable > 1


def test_every_quantity_of_a_draw_is_one_number():
    robots = draw(DISTRIBUTIONS, SPEC, [robot_seed(1, k) for k in range(3)])
    found = parameter_values(robots, DISTRIBUTIONS)
    assert found.keys() == set(robots)
    assert all(column.shape == (3,) and np.isfinite(column).all() for column in found.values())
    np.testing.assert_allclose(found["joints.friction"], robots["joints.friction"].mean(axis=1))
    np.testing.assert_allclose(
        found["mounting.tilt_rad"] ** 2 * 2, (robots["mounting.tilt_rad"] ** 2).sum(axis=1)
    )
    np.testing.assert_allclose(found["wear.torque_constant"], robots["wear.torque_constant"].mean(axis=1))
