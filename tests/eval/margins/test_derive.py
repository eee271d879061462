"""Margins from known excesses."""

import numpy as np
import pytest
from scipy.stats import norm

pytest.importorskip("mujoco")

from eval.margins.derive import PER_HOUR, need, noise_of, share_needed, worst_bin
from eval.margins.excess import BINS
from support.arm6 import SPEC
from support.planar import PLANAR3

NEVER = -np.inf


@pytest.mark.parametrize(
    ("excess", "noise", "share"),
    [
        ([0.1] * 10, 0.0, 0.9),
        ([0.1] * 10, 0.05, 0.85),
        ([0.4] * 5 + [0.2] * 5, 0.0, 0.8),  # 0.4 below half of the limit does no harm
        ([0.1] * 7 + [NEVER] * 3, 0.0, 1.0),  # nobody planned more
        ([0.1] * 3 + [NEVER] * 4 + [0.25] * 3, 0.0, 0.75),
        ([0.1] * 5 + [0.55] + [0.1] * 4, 0.0, 0.5),  # not beyond a bin that comes to the limit
        ([0.1] * 5 + [0.45] + [0.1] * 4, 0.0, 0.55),
        ([1.0] + [0.0] * 9, 0.0, 0.0),
    ],
)
def test_share_up_to_which_the_limit_is_kept(excess, noise, share):
    assert share_needed(np.array(excess), noise) == pytest.approx(share)


def bins(**excess):
    return np.array([excess.get(f"at_{place}", NEVER) for place in range(BINS)])


def test_needed_margins_are_rounded_to_the_safe_side():
    found = need(SPEC, "speed", np.full(BINS, 0.1234), noise=0.0, stop=0.0)
    assert (found.key, found.needed, found.planned) == ("speed", 0.87, 1.0)
    assert found.holds == (SPEC.margins.speed <= 0.87)
    found = need(SPEC, "workspace", np.array([0.0021]), noise=0.0, stop=0.0013)
    assert (found.key, found.needed, found.planned, found.holds) == ("workspace_m", 0.004, 0.0, True)
    assert not need(SPEC, "gap", np.array([0.0101]), noise=0.0, stop=0.0).holds
    assert need(SPEC, "gap", np.array([0.0099]), noise=0.0, stop=0.0).holds
    present = SPEC.margins.tool_speed
    assert need(SPEC, "tool_speed", np.full(BINS, 0.0), noise=0.0, stop=1.0 - present).holds
    assert not need(SPEC, "tool_speed", np.full(BINS, 0.0), noise=0.0, stop=1.01 - present).holds


def test_deciding_bin_is_where_planned_value_and_excess_come_closest_to_the_limit():
    assert worst_bin(bins(at_2=0.6, at_7=0.15)) == 7
    assert worst_bin(bins(at_2=0.6, at_7=0.05)) == 2


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


def test_a_robot_without_workspace_has_noise_of_joints_only():
    assert set(noise_of(PLANAR3, ERROR[:, :3])) == {"angle", "speed"}
