"""Margins from known excesses."""

import numpy as np
import pytest
from scipy.stats import norm

pytest.importorskip("mujoco")

from eval.margins import derive
from eval.margins.derive import PER_HOUR, need, noise_of, share_needed, stop_excess
from eval.margins.excess import BINS
from robots.errors import ConfigError
from support.arm6 import SPEC
from support.planar import PLANAR3

NEVER = -np.inf


INF = np.inf


def bins(usual=NEVER, **excess):
    return np.array([excess.get(f"at_{place}", usual) for place in range(BINS)])


@pytest.mark.parametrize(
    ("excess", "added", "share", "place"),
    [
        (bins(usual=0.1), 0.0, 0.9, 9),
        (bins(usual=0.1), 0.05, 0.85, 8),
        (bins(at_0=0.6, at_4=0.4, at_8=0.2), 0.0, 0.8, 8),  # 0.4 at half of the limit does no harm
        (bins(at_0=0.1, at_6=0.1), 0.0, INF, 6),  # nobody planned more
        (bins(at_2=0.6, at_7=0.15), 0.0, INF, 7),
        (bins(at_2=0.6, at_7=0.05), 0.0, INF, 2),
        (bins(usual=0.1, at_5=0.55), 0.0, 0.5, 5),  # not into a bin that comes to the limit
        (bins(usual=0.1, at_5=0.45), 0.0, 0.55, 5),
        (bins(usual=0.0, at_0=1.0), 0.0, 0.0, 0),
        (bins(usual=0.0, at_3=INF), 0.0, 0.3, 3),
        (bins(usual=0.0, at_3=np.nan), 0.0, 0.0, 3),
    ],
)
def test_share_up_to_which_the_limit_is_kept(excess, added, share, place):
    assert share_needed(excess, added) == (pytest.approx(share), place)


def test_needed_margins_are_rounded_to_the_safe_side():
    found = need(SPEC, "speed", bins(usual=0.1234), noise=0.0, stop=0.0)
    assert (found.key, found.needed, found.planned, found.worst) == ("speed", 0.87, 1.0, 0.1234)
    assert found.holds
    found = need(SPEC, "workspace", np.array([0.0021]), noise=0.0, stop=0.0013)
    assert (found.key, found.needed, found.planned, found.holds) == ("workspace_m", 0.004, 0.0, True)
    assert not need(SPEC, "gap", np.array([0.0131]), noise=0.0, stop=0.0).holds
    assert need(SPEC, "gap", np.array([0.0099]), noise=0.0, stop=0.0).holds
    present = SPEC.margins.tool_speed
    assert need(SPEC, "tool_speed", bins(usual=0.0), noise=0.001, stop=0.989 - present).holds
    assert not need(SPEC, "tool_speed", bins(usual=0.0), noise=0.001, stop=1.0 - present).holds


def test_a_stop_plans_more_than_its_setpoint_but_no_more_excess():
    found = need(SPEC, "tau", bins(at_5=0.35, at_7=0.1, at_8=0.05), noise=0.0, stop=0.1)
    assert (found.needed, found.holds) == (INF, True)
    found = need(SPEC, "tau", bins(at_5=0.35, at_7=0.1, at_8=0.15), noise=0.0, stop=0.1)
    assert (found.needed, found.holds) == (0.75, True)


def test_what_nobody_planned_says_nothing():
    found = need(SPEC, "tau", bins(at_0=0.3, at_5=0.3), noise=0.0, stop=0.0)
    assert (found.needed, found.planned, found.holds) == (INF, pytest.approx(0.6), True)
    for quantity, excess in (("tau", bins()), ("angle", np.array([NEVER]))):
        with pytest.raises(ConfigError, match=r"arm6: no robot could be armed"):
            need(SPEC, quantity, excess, noise=0.0, stop=0.0)


def test_stops_that_nobody_accepts_are_named(monkeypatch):
    monkeypatch.setattr(derive.StopSearch, "worst", lambda *_: np.nan)
    with pytest.raises(ConfigError, match=r"planar3: no stop from a pose .* is accepted"):
        stop_excess(PLANAR3, 1)


def test_stops_of_a_robot_without_workspace_have_torque_only(monkeypatch):
    monkeypatch.setattr(derive.StopSearch, "worst", lambda search, name, *_: search.bounds[name] + 0.02)
    assert stop_excess(PLANAR3, 1) == {"tau": pytest.approx(0.02)}
    found = stop_excess(SPEC, 1)
    assert (found["tau"], found["tool_speed"]) == (pytest.approx(0.02), pytest.approx(0.02))
    assert found["workspace"] == pytest.approx(0.02 * SPEC.workspace.radius_max)
    assert found["gap"] == pytest.approx(0.02)


ERROR = np.array([[1e-3] * SPEC.n, [0.05] * SPEC.n])


def test_noise_is_passed_once_in_a_million_hours():
    found = noise_of(SPEC, ERROR)
    deviations = found["angle"] / 1e-3
    per_hour = 2 * norm.sf(deviations) * SPEC.n * 3600 / SPEC.dt
    assert per_hour == pytest.approx(PER_HOUR, rel=1e-6)
    assert found["speed"] == pytest.approx(deviations * 0.05 / 3.14, rel=1e-6)
    assert "tau" not in found


def test_noise_of_the_tool_is_that_of_the_longest_lever():
    """Of one joint that turns the stretched arm about its base axis."""
    only = np.zeros_like(ERROR)
    only[:, 0] = ERROR[:, 0]
    found = noise_of(SPEC, only)
    lever = found["workspace"] / found["angle"]
    assert 0.7 < lever < 1.0
    assert found["gap"] == found["workspace"]
    speed = found["speed"] * SPEC.joints[0].qd_max
    assert found["tool_speed"] == pytest.approx(lever * speed / SPEC.workspace.tool_speed_max, rel=1e-6)


def test_a_robot_without_workspace_has_shapes_that_noise_moves():
    found = noise_of(PLANAR3, ERROR[:, :3])
    assert set(found) == {"angle", "speed", "workspace", "gap"}
    assert found["gap"] > 0.9 * found["angle"]
