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
        monkeypatch.setattr(plan_points, "_put", plan_points.put_points)
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


@pytest.mark.parametrize(
    ("part", "said"),
    [
        ({"q": some(STOP_MOMENTS - 1)}, "moments: found shape \\(4, 3, 6\\), expected \\(5, 3, 6\\)"),
        ({"q_rest": some()[:1]}, "end: found shape \\(1, 6\\), expected \\(3, 6\\)"),
        ({"ahead": Setpoint(*some(3)[:, :2])}, "first step: found shape \\(2, 6\\), expected \\(3, 6\\)"),
    ],
)
def test_stops_of_other_shapes_are_refused(part, said):
    here = Setpoint(*some(3))
    stop = Stop(here, *some(3, STOP_MOMENTS), q_rest=some())._replace(**part)
    with pytest.raises(ValueError, match=f"^stop: {said}$"):
        plan_points.plan_points(here, stop, np.ones(SPEC.n))
