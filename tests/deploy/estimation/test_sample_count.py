"""Thresholds are durations: at another rate a robot gets the count of samples that the seconds demand."""

import numpy as np
import pytest

from deploy.estimation.estimator import Estimator
from deploy.estimation.fault_detection import STUCK_S
from deploy.estimation.floating_base.base_filter import BaseFilter
from deploy.estimation.joint_filter import CONFIRMED_S
from deploy.estimation.sample_count import sample_count
from deploy.reasons import Reason
from robots.tables import Rates
from support.arm6 import SPEC
from support.deploy.estimators import sample, still
from support.deploy.floating_bases import NOISE


def at_rate(control_hz, sensor_hz):
    """The arm at another control rate, its sensors at another rate of their own."""
    sensors = {
        k: s.model_copy(update={"rate_hz": min(sensor_hz, s.rate_hz * 5)}) for k, s in SPEC.sensors.items()
    }
    return SPEC.model_copy(
        update={"rates": Rates(control_hz=control_hz, physics_hz=control_hz), "sensors": sensors}
    )


def counts(estimator):
    """Samples until confirmed, until restarted, in the mean NIS, of a stuck encoder, of an external torque."""
    return *estimator.joints.rules[2:], estimator.stuck_detection.looks, estimator.external_torque.packets_min


@pytest.mark.parametrize(
    ("control_hz", "sensor_hz", "expected"),
    [
        (200, 200, (10, 20, 50, 5, 3)),
        (500, 500, (25, 50, 125, 5, 3)),
        (1000, 1000, (50, 100, 250, 5, 3)),
        (1000, 200, (10, 20, 50, 20, 3)),
        (200, 5, (1, 1, 1, 1, 1)),
    ],
)
def test_counts_of_the_joints_follow_the_rates(control_hz, sensor_hz, expected):
    assert counts(Estimator(at_rate(control_hz, sensor_hz), 1)) == expected


@pytest.mark.parametrize(
    ("imu_hz", "look_s", "expected"),
    [(200, 0.015, (10, 100, 5)), (1000, 0.016, (50, 94, 5)), (5, 0.2, (1, 8, 1))],
)
def test_counts_of_the_base_follow_the_rates(imu_hz, look_s, expected):
    base = BaseFilter(NOISE, 1.0 / imu_hz, 1, 4, look_s=look_s)
    found = base.imu_check.samples, base.divergence.nis_samples, base.divergence.contradictions_max
    assert found == expected


def test_a_duration_is_at_least_one_sample():
    assert (sample_count(0.05, 0.005), sample_count(0.05, 1.0), sample_count(0.0, 1.0)) == (10, 1, 1)


@pytest.mark.parametrize(("control_hz", "sensor_hz"), [(200, 200), (500, 500), (1000, 1000), (1000, 200)])
def test_a_filter_is_confirmed_and_a_stuck_encoder_found_after_the_same_time(control_hz, sensor_hz):
    """Also where packets arrive in ticks in which nothing else is looked at."""
    spec = at_rate(control_hz, sensor_hz)
    estimator, every, confirmed, stuck = Estimator(spec, 1), control_hz // sensor_hz, [], []
    taken = 0.0
    for tick in range(round(0.5 / spec.dt)):
        now = tick * spec.dt
        setpoint = still(1, 0.1 * now)._replace(qd=still(1, 0.1).q)
        fresh = tick % every == every - 1
        taken = now if fresh else taken
        held = 0.1 * min(taken, 0.2)
        state = estimator.step(now, sample([taken], [fresh], np.full((1, spec.n), held)), setpoint)
        confirmed.append(np.isfinite(state.age[0]))
        stuck.append(bool(state.fault[0] & Reason.STUCK))
    sample_s = 1.0 / sensor_hz
    assert np.argmax(confirmed) * spec.dt == pytest.approx(CONFIRMED_S, abs=1.01 * sample_s)
    assert np.argmax(stuck) * spec.dt == pytest.approx(0.2 + STUCK_S, abs=0.031)
