"""Kinematics of one pose stay those of that pose, and say what they do not have."""

import numpy as np
import pytest

from robots.models.fleet import Fleet
from robots.spec import load_robot
from support.arm6 import NO_TOOL, SPEC, copy_of_arm

HOME = SPEC.joint_array("q_home")[None]


def test_what_the_fleet_computes_later_changes_no_earlier_kinematics():
    fleet = Fleet(SPEC, 1, collisions=True)
    home, tau = fleet.kinematics(HOME), fleet.torque(HOME, HOME * 0, HOME * 0)
    before = home.tool_position.copy(), home.manipulability(), home.tool_velocity(HOME), tau.copy()
    fleet.kinematics(HOME + 0.5)
    fleet.torque(HOME + 0.5, HOME, HOME)
    after = home.tool_position, home.manipulability(), home.tool_velocity(HOME), tau
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one, other)


def test_kinematics_without_jacobians_have_no_velocities():
    kinematics = Fleet(SPEC, 1).kinematics(HOME, jacobians=False)
    for read in (kinematics.manipulability, lambda: kinematics.tool_velocity(HOME)):
        with pytest.raises(RuntimeError, match="computed without Jacobians"):
            read()


def test_a_robot_without_tool_has_no_tool_position(tmp_path):
    kinematics = Fleet(load_robot(copy_of_arm(tmp_path, toml=NO_TOOL)), 1).kinematics(HOME)
    with pytest.raises(RuntimeError, match="the robot has no tool"):
        _ = kinematics.tool_position


def test_joints_that_do_not_carry_the_tool_do_not_move_it(tmp_path):
    """A tool on the forearm: only the three joints before it count."""
    spec = load_robot(copy_of_arm(tmp_path, toml=[('tool = "tool" ', 'tool = "forearm_link" ')]))
    kinematics, wrist = Fleet(spec, 1).kinematics(HOME), np.array([[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]])
    np.testing.assert_array_equal(kinematics.tool_velocity(wrist), np.zeros((1, 3)))
    np.testing.assert_array_equal(kinematics.torque_of_tool_force(np.ones((1, 3)))[0, 3:], np.zeros(3))
    assert np.abs(kinematics.tool_velocity(1.0 - wrist)).max() > 0.1
    assert abs(kinematics.manipulability()[0]) > 0.01


def test_speeds_and_forces_of_other_shapes_are_refused():
    kinematics = Fleet(SPEC, 2).kinematics(np.repeat(HOME, 2, axis=0))
    for qd, robots in ((HOME, None), (np.zeros((2, 5)), None), (np.zeros((2, 6)), np.array([0]))):
        with pytest.raises(ValueError, match=r"^joint speeds: found shape \("):
            kinematics.tool_velocity(qd, robots)
    for force in (np.zeros((1, 3)), np.zeros((2, 4))):
        with pytest.raises(ValueError, match=r"^force on the tool: found shape .*, expected \(2, 3\)$"):
            kinematics.torque_of_tool_force(force)
