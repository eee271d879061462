"""Guards against what a policy does again and again, in the whole tick."""

import numpy as np
import pytest

from deploy.reasons import Reason
from deploy.state import Mode
from robots.models.fleet import Fleet
from robots.motors.control_mode import ControlMode
from robots.randomness import robot_seed
from support.arm6 import SPEC
from support.modes import mode_contract
from support.runtimes import DT, N, Saying, built, every, heard, play, simulate

MARGINS, SPACE = SPEC.margins, SPEC.workspace


@pytest.mark.parametrize(("hz", "stopped"), [(4.0, True), (0.5, False)])
def test_a_policy_that_shakes_is_stopped(hz, stopped):
    """With half of the arm's bound: its limits of jerk leave no more speed than a tenth of the limit at 5 Hz."""
    margins, contract = MARGINS.model_copy(update={"oscillation_hz": 2.5}), mode_contract("position")
    spec, seeds = SPEC.model_copy(update={"margins": margins}), [robot_seed(5, robot) for robot in range(4)]
    runtime, reasons = simulate(spec, contract, seeds, policy := Saying(4))[0], []
    heard(runtime)
    assert not runtime.arm(every(runtime)).any()
    for _ in range(round(4.0 / DT)):
        policy.action[:, 3:] = np.sign(np.sin(2 * np.pi * hz * runtime.t))
        runtime.tick()
        reasons.append(runtime.supervisor.reason.copy())
    expected = Reason.OSCILLATION if stopped else Reason(0)
    assert [Reason(int(reason)) for reason in np.bitwise_or.reduce(reasons)] == [expected] * 4


def test_a_policy_that_is_stopped_again_and_again_is_latched():
    """It drives the arm into the table: a stop of category 2 each time."""
    policy = Saying(2)
    runtime = built(2, policy=policy, contract=mode_contract("position"))
    heard(runtime)
    assert not runtime.arm(every(runtime)).any()
    policy.action[0, 1:3] = 1.0
    stops = 0
    while runtime.supervisor.mode[0] != Mode.LATCHED and runtime.t < MARGINS.stops_s:
        begins = runtime.supervisor.running[0]
        runtime.tick()
        stops += begins and not runtime.supervisor.running[0]
    assert stops == MARGINS.stops_max
    reason = Reason(int(runtime.supervisor.reason[0]))
    assert reason in (Reason.COLLISION | Reason.REPEATED, Reason.WORKSPACE | Reason.REPEATED)
    assert runtime.supervisor.mode[1] == Mode.RUNNING
    policy.action[:] = 0.0
    ids = np.array([True, False])  # the operator moves it away from the table
    runtime.robot.reset(ids, np.tile(SPEC.joint_array("q_home"), (2, 1)))
    runtime.reset(ids)
    heard(runtime)
    assert not runtime.arm(ids).any()
    _, modes = play(runtime, 60)
    assert modes[-1, 0] == Mode.RUNNING


@pytest.mark.parametrize("mode", ["position", "velocity", "torque"])
def test_poses_are_refused_by_the_margins_of_the_mode(mode):
    """Between its margins and those of position mode only torque mode refuses a pose."""
    runtime, margins = (
        built(1, contract=mode_contract(mode)),
        MARGINS.of(control_mode := ControlMode[mode.upper()]),
    )
    low, high = SPEC.joint_array("q_min") + 0.1, SPEC.joint_array("q_max") - 0.1
    fleet, both = Fleet(SPEC.in_mode(control_mode), 2, collisions=True), Reason.COLLISION | Reason.WORKSPACE
    expected, found = [], []
    for q in np.random.default_rng(3).uniform(low, high, (600, 2, N)):
        tool = fleet.kinematics(q, jacobians=False).tool_position
        inside = np.minimum(
            tool[:, 2] - SPACE.z_min, SPACE.radius_max - np.linalg.norm(tool - SPACE.centre, axis=1)
        )
        gap = np.array([fleet.nearest_shapes(pose[None])[0] for pose in q])
        near = gap < margins.collision_m, inside < margins.workspace_m
        expected += [near[0] * Reason.COLLISION | near[1] * Reason.WORKSPACE]
        found += [runtime.safety.check_poses(q) & np.int64(both)]
    np.testing.assert_array_equal(found, expected)


def test_margins_of_torque_mode_are_wider():
    """Or the test above would prove nothing."""
    position, torque = MARGINS.of(ControlMode.POSITION), MARGINS.of(ControlMode.TORQUE)
    assert position == MARGINS
    assert torque.collision_m > 2 * position.collision_m
    assert torque.workspace_m > 2 * position.workspace_m
