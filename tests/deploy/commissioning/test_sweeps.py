"""Measurements of synthetic runs, whose results are known in closed form."""

import numpy as np
import pytest

from deploy.commissioning.packet_log import PacketLog
from deploy.commissioning.responses import Nudge, Span, response
from deploy.commissioning.sweeps import measure
from robots.models.fleet import Fleet
from robots.spec import load_robot

SPEC = load_robot("planar3")
DT, CONSTANT = SPEC.dt, np.array([6.0, 5.0, 7.0])
SPEED, TURN = 0.15, 0.2
PASS = 200
"""Ticks of a pass at constant speed, after TURN s at rest."""


def triangle(t):
    """Setpoint that goes to and fro at SPEED, with rests."""
    rest = round(TURN / DT)
    knots_t, knots_q = [0.0], [0.0]
    for number in range(6):
        knots_t += [knots_t[-1] + rest * DT, knots_t[-1] + (rest + PASS) * DT]
        knots_q += [knots_q[-1], knots_q[-1] + (SPEED * PASS * DT) * (-1) ** number]
    return np.interp(t, knots_t, knots_q)


def passes():
    rest = round(TURN / DT)
    begins = [rest + number * (rest + PASS) for number in range(6)]
    return [Span(begin, begin + PASS) for begin in begins]


class Synthetic(PacketLog):
    """Joint 1 moves; its encoder is scaled and late, its motor has friction, a load, and perhaps one that comes."""

    def __init__(self, *, scale=1.0, late=0.003, age=0.01, friction=0.4, load=0.7, comes=None, noise=0.001):
        super().__init__()
        rng, fleet, still = np.random.default_rng(4), Fleet(SPEC, 1), np.zeros((1, 3))
        for tick in range(6 * (PASS + round(TURN / DT)) + 50):
            t = tick * DT
            sent = np.zeros(3)
            sent[1] = triangle(t + DT)
            measured = max(t - age, 0.0)
            encoder = rng.normal(0.0, noise, 3)
            encoder[1] += scale * triangle(measured - late)
            direction = np.sign(round(triangle(measured + 1e-4) - triangle(measured - 1e-4), 9))
            q = np.array([0.0, triangle(t), 0.0])
            tau = fleet.torque(q[None], still, still)[0] + load + friction * direction
            tau = tau + (5.0 if comes is not None and tick > comes else 0.0)
            current = tau / CONSTANT + rng.normal(0.0, 0.02, 3)
            speed = np.zeros(3)
            speed[1] = (triangle(t + DT) - triangle(t)) / DT
            values = (t, 2, measured, encoder, measured, current, sent, speed, q)
            for column, value in zip(self._rows.values(), values, strict=True):
                column.append(value)


def measured(**how):
    return measure(Synthetic(**how), 1, passes(), Fleet(SPEC, 1), CONSTANT, DT)


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.03])
@pytest.mark.parametrize("late", [0.0, 0.0033, 0.04])
def test_scale_delay_and_age_are_found(scale, late):
    found = measured(scale=scale, late=late)
    assert found.scale == pytest.approx(scale, abs=0.002)
    assert abs(found.scale - scale) < 4 * found.scale_error
    assert found.delay_s == pytest.approx(late, abs=0.001)
    assert found.age_s == pytest.approx(0.01)
    assert found.speed == pytest.approx(SPEED)
    assert np.abs(np.delete(found.others, 1)).max() < 0.005


def test_friction_and_gravity_are_told_apart():
    found = measured()
    assert found.friction == pytest.approx(0.4, abs=4 * found.torque_error)
    assert found.gravity == pytest.approx(0.7, abs=4 * found.torque_error)
    assert found.torque_error < 0.02


@pytest.mark.parametrize("comes", [300, 520, 700])
def test_load_that_comes_in_between_is_no_friction(comes):
    found = measured(comes=comes)
    assert found.friction == pytest.approx(0.4, abs=0.05)


def test_tracking_error_is_that_of_raw_packets():
    found = measured(late=0.04, noise=0.0)
    assert found.tracking_rad == pytest.approx(SPEED * 0.04, rel=0.02)


def test_response_to_a_nudge():
    log, first, second = Synthetic(scale=-0.8), *passes()[:2]
    rest = round(TURN / DT)
    down, low = second, Span(second.end, second.end + rest)
    nudge = Nudge(1, first, Span(first.end, first.end + rest), down, low)
    found = response(log, nudge)
    np.testing.assert_allclose(found.encoder, [0.0, -0.8, 0.0], atol=0.01)
    assert found.current[1] == pytest.approx(2 * 0.4 / CONSTANT[1], abs=0.05)
    assert found.noise.max() < 0.01
    assert 0.001 < found.current_noise[1] < 0.02
