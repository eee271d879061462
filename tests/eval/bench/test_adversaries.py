"""The bench of hostile policies on the planar arm, for seconds."""

import pytest

from support.planar import PLANAR3

pytest.importorskip("mujoco")

from eval.bench.adversaries import POLICIES, Case, run_case
from robots.motors.control_mode import ControlMode


@pytest.mark.parametrize("policy", POLICIES)
def test_a_row_shows_hard_events_stops_time_in_operation_and_the_worst_ratios(policy):
    case = Case(PLANAR3.folder, ControlMode.TORQUE, policy, hours=0.002)
    hard_events, stops, in_operation, worst = run_case(case)
    assert hard_events == "0"
    assert int(stops) > 16
    assert 10 < int(in_operation.removesuffix(" %")) < 100
    ratios = [float(each.split()[1]) for each in worst.split(", ")]
    assert len(ratios) == 3
    assert 0.5 < max(ratios) <= 1.0
    assert ratios == sorted(ratios, reverse=True)
