from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from robots.motors.motor import MotorHeat, temperatures
from support.robots.motors import RE40


@pytest.mark.parametrize(("seconds", "winding"), [(60, 43), (600, 71), (3600, 121), (8 * 3600, 130)])
def test_published_course_of_an_re40(seconds, winding):
    assert temperatures(RE40, 3.12, 25.0, seconds)[0] == pytest.approx(winding, abs=0.5)


def by_integration(heat, current, ambient, t):
    """The oracle: the two equations as they stand in the docstring, integrated numerically."""

    def slope(_, x):
        winding, housing = x
        loss = current**2 * heat.resistance * (1 + heat.alpha * (winding - heat.reference_c))
        inner = (winding - housing) / heat.winding_to_housing
        outer = (housing - ambient) / heat.housing_to_ambient
        return (loss - inner) / heat.winding_capacity, (inner - outer) / heat.housing_capacity

    return solve_ivp(slope, (0, t), (ambient, ambient), method="LSODA", rtol=1e-10, atol=1e-8).y[:, -1]


@settings(max_examples=40)
@given(
    resistance=st.floats(0.1, 5),
    winding_to_housing=st.floats(0.5, 5),
    housing_to_ambient=st.floats(0.5, 5),
    winding_capacity=st.floats(5, 100),
    housing_capacity=st.floats(200, 2000),
    watts=st.floats(0, 15),
    ambient=st.floats(-20, 50),
    t=st.floats(1, 20_000),
)
def test_equals_the_integrated_equations(watts, ambient, t, **constants):
    heat = MotorHeat(alpha=0.0039, reference_c=20.0, **constants)
    current = np.sqrt(watts / heat.resistance)
    expected = by_integration(heat, current, ambient, t)
    np.testing.assert_allclose(temperatures(heat, current, ambient, t), expected, rtol=1e-6, atol=1e-4)


def test_without_current_nothing_warms():
    assert temperatures(RE40, 0.0, 31.0, 1e5) == pytest.approx((31.0, 31.0), abs=1e-9)


def test_temperatures_at_time_zero_are_the_initial_ones():
    assert temperatures(RE40, 5.0, -10.0, 0.0) == (-10.0, -10.0)


def test_steady_state_balances_loss_and_cooling():
    winding, housing = temperatures(RE40, 3.12, 25.0, 1e6)
    loss = 3.12**2 * RE40.resistance * (1 + RE40.alpha * (winding - 25.0))
    assert (winding - housing) / RE40.winding_to_housing == pytest.approx(loss, rel=1e-9)
    assert (housing - 25.0) / RE40.housing_to_ambient == pytest.approx(loss, rel=1e-9)


def test_too_much_current_is_a_thermal_runaway():
    """R(T) feeds itself: above some current there is no steady state, and the closed form says so."""
    hour, two = (temperatures(RE40, 8.0, 25.0, t)[0] for t in (3600, 7200))
    assert two - hour > 2 * (hour - 25.0)


def test_singular_matrix_at_the_stability_limit_gives_a_finite_result():
    """Where self-heating just eats all cooling, heat grows without bound but steadily."""
    current = np.sqrt(1 / (RE40.alpha * RE40.resistance * (1.93 + 4.65)))
    assert by_integration(RE40, current, 25.0, 3000) == pytest.approx(
        temperatures(RE40, current, 25.0, 3000), rel=1e-6
    )


def test_constant_resistance_is_the_textbook_sum():
    cold = replace(RE40, alpha=0.0)
    assert temperatures(cold, 2.0, 0.0, 1e6)[0] == pytest.approx(4 * 1.16 * (1.93 + 4.65), rel=1e-9)
