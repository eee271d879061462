"""Margins written into robot.toml."""

import pytest

from eval.margins.derive import Need
from eval.margins.robot_file import write_margins
from robots.errors import ConfigError
from robots.motors.control_mode import ControlMode
from robots.spec import load_robot
from support.arm6 import SPEC, copy_of_arm


def lacking(quantity, key, needed):
    return Need(
        quantity=quantity, planned=0.0, worst=0.0, noise=0.0, stop=0.0, key=key, present=0.0, needed=needed
    )


def test_margins_are_written_to_their_mode_and_all_else_is_kept(tmp_path):
    folder = copy_of_arm(tmp_path)
    before = (folder / "robot.toml").read_text()
    needs = {
        ControlMode.POSITION: [lacking("speed", "speed", 0.7), lacking("angle", "q_soft_rad", 0.04)],
        ControlMode.VELOCITY: [
            lacking("workspace", "workspace_m", 0.02),
            lacking("tool_speed", "tool_speed", 0.9),
            lacking("angle", "q_soft_rad", 0.035),
        ],
        ControlMode.TORQUE: [lacking("speed", "speed", 0.6), lacking("tool_speed", "tool_speed", 0.88)],
    }
    assert write_margins(load_robot(folder), needs) == folder / "robot.toml"
    spec = load_robot(folder)
    assert (spec.margins.speed, spec.margins.q_soft_rad, spec.margins.q_target_rad) == (0.7, 0.04, 0.06)
    assert spec.margins.of(ControlMode.VELOCITY).workspace_m == 0.02
    assert spec.margins.of(ControlMode.TORQUE).speed == 0.6
    assert spec.margins.of(ControlMode.VELOCITY).tool_speed == 0.9
    assert spec.margins.of(ControlMode.VELOCITY).q_soft_rad == 0.035
    assert spec.margins.of(ControlMode.TORQUE).tool_speed == 0.88
    assert spec.margins.tool_speed == SPEC.margins.tool_speed
    after = (folder / "robot.toml").read_text().splitlines()
    changed = [line for line in before.splitlines() if line not in after]
    assert len(changed) == 5
    assert sum("#" in line for line in after) == before.count("#")


def test_tool_speeds_of_other_modes_stay_when_one_gets_its_own(tmp_path):
    folder = copy_of_arm(tmp_path, toml=(("tool_speed = 0.87 .*\n", ""), ("tool_speed = 0.66\n", "")))
    before = load_robot(folder).margins
    write_margins(load_robot(folder), {ControlMode.POSITION: [lacking("tool_speed", "tool_speed", 0.81)]})
    after = load_robot(folder).margins
    assert after.tool_speed == 0.81
    for mode in (ControlMode.VELOCITY, ControlMode.TORQUE):
        assert after.of(mode).tool_speed == before.of(mode).speed


@pytest.mark.parametrize(("mode", "target"), [(ControlMode.VELOCITY, 0.08), (ControlMode.TORQUE, 0.05)])
def test_targets_of_angles_move_with_soft_limits(mode, target, tmp_path):
    folder = copy_of_arm(tmp_path)
    write_margins(load_robot(folder), {mode: [lacking("angle", "q_soft_rad", 0.06)]})
    after = load_robot(folder).margins
    assert (after.q_target_rad, after.q_soft_rad, after.of(mode).q_soft_rad) == (target, 0.03, 0.06)


def test_a_margin_that_a_robot_cannot_have_changes_nothing(tmp_path):
    folder = copy_of_arm(tmp_path)
    before = (folder / "robot.toml").read_text()
    with pytest.raises(ConfigError, match=r"cannot have the margins .*robot\.toml: margins\.speed"):
        write_margins(load_robot(folder), {ControlMode.POSITION: [lacking("speed", "speed", 0.0)]})
    assert (folder / "robot.toml").read_text() == before
