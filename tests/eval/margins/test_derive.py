"""Margins from known excesses."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from eval.attack.arena import Setting
from eval.margins.derive import PROBABILITY, find_worst, need, noise_of, share_needed, worst_bin
from eval.margins.excess import BINS
from eval.margins.tail import level
from eval.margins.trial import Trials, Tried
from eval.shard.job import WIDTH
from robots.motors.control_mode import ControlMode
from support.arm6 import SPEC

NEVER = -np.inf
SETTING = Setting(robot=SPEC.folder, mode=ControlMode.POSITION)


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


def bins(place, value):
    excess = np.full(BINS, NEVER)
    excess[place] = value
    return excess


def test_needed_margins_are_rounded_to_the_safe_side():
    found = need(SPEC, "speed", np.full(BINS, 0.1234), 8, noise=0.0, stop=0.0)
    assert (found.key, found.needed, found.planned) == ("speed", 0.87, 0.9)
    assert found.holds == (SPEC.margins.speed <= 0.87)
    found = need(SPEC, "workspace", np.array([0.0021]), 0, noise=0.0, stop=0.0013)
    assert (found.key, found.needed, found.planned, found.holds) == ("workspace_m", 0.004, 0.0, True)
    assert not need(SPEC, "gap", np.array([0.0101]), 0, noise=0.0, stop=0.0).holds
    assert need(SPEC, "gap", np.array([0.0099]), 0, noise=0.0, stop=0.0).holds
    present = SPEC.margins.tool_speed
    assert need(SPEC, "tool_speed", np.full(BINS, 0.0), 9, noise=0.0, stop=1.0 - present).holds
    assert not need(SPEC, "tool_speed", np.full(BINS, 0.0), 9, noise=0.0, stop=1.01 - present).holds


def test_deciding_bin_is_where_planned_value_and_excess_come_closest_to_the_limit():
    assert worst_bin(np.stack([bins(2, 0.6), bins(7, 0.15)])) == 7
    assert worst_bin(np.stack([bins(2, 0.6), bins(7, 0.05)])) == 2


def test_worst_trial_is_found_among_all():
    def tried(seed, excess):
        policies = tuple({"reach": (float(seed), float(k))} for k in range(2 * WIDTH))
        return Tried(Trials(SETTING, "push", seed, 2, False), {"angle": excess}, policies)

    blocks = [np.zeros((2 * WIDTH, 1)) for _ in range(2)]
    blocks[1][WIDTH + 3] = 0.5
    worst, place, largest = find_worst([tried(seed, x) for seed, x in enumerate(blocks)], "angle")
    assert (worst.seed, worst.robot, place) == (1, 3, 0)
    assert worst.policy == {"reach": (1.0, float(WIDTH + 3))}
    assert largest.tolist() == [0.5]


def test_noise_is_the_level_of_repeats_over_their_median():
    repeats = np.column_stack([np.full(64, NEVER), np.random.default_rng(0).normal(0.2, 0.01, 64)])
    repeats[5, 1] = NEVER
    known = np.delete(repeats[:, 1], 5)
    expected = level(known, PROBABILITY) - np.median(known)
    assert noise_of({"angle": repeats}, "angle", 1) == pytest.approx(expected)
    assert noise_of({"angle": repeats}, "angle", 0) == 0.0
