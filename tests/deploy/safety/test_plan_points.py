"""Points of plans against numpy."""

import numpy as np
import pytest

from deploy.safety import plan_points
from deploy.state import STOP_MOMENTS, Setpoint, Stop
from support.arm6 import SPEC

ROBOTS, RNG = 3, np.random.default_rng(0)


def some(*shape):
    return RNG.normal(size=(*shape, ROBOTS, SPEC.n))


@pytest.mark.parametrize("compiled", [True, False])
def test_points_are_side_by_side(compiled, monkeypatch):
    if not compiled:
        monkeypatch.setattr(plan_points, "_put", getattr(plan_points._put, "py_func", plan_points._put))
    twice_jerk = 2 * SPEC.joint_array("qddd_max")
    here, ahead = Setpoint(*some(3)), Setpoint(*some(3))
    stop = Stop(ahead, *some(3, STOP_MOMENTS), q_rest=some())
    found = plan_points.plan_points(here, stop, twice_jerk)
    for name in ("q", "qd", "qdd"):
        expected = np.concatenate((getattr(here, name), getattr(ahead, name), *getattr(stop, name)))
        np.testing.assert_array_equal(getattr(found, name), expected)
    peak = found.qd + found.qdd * np.abs(found.qdd) / twice_jerk
    np.testing.assert_array_equal(found.qd_peak, peak)
    np.testing.assert_array_equal(found.poses, np.concatenate((here.q, *stop.q, stop.q_rest)))
    np.testing.assert_array_equal(found.qd_of_tool, np.concatenate((here.qd, peak[:ROBOTS], *stop.qd)))
