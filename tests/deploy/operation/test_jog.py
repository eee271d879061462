import json
import os
import re
import sys
import termios
from functools import partial

import numpy as np
import pytest

import deploy.operation.cli
import deploy.operation.session
from deploy.backends.sim.robot import SimRobot
from deploy.operation.jog import SPEED_SHARE, TOOL_SPEED, Jog, reduced_speed
from deploy.operation.jog_keys import STEP_RAD
from deploy.telemetry.console_display import line
from robots.spec import load_robot
from support.arm6 import NO_TOOL, SPEC, copy_of_arm
from support.paths import TEST_ROBOTS
from support.policies import policy_model, saved
from support.screen import NoScreen

SPEED = SPEED_SHARE * SPEC.margins.speed * SPEC.joint_array("qd_max")


@pytest.fixture
def robots(monkeypatch):
    """Every simulated robot that is opened, with the course of its true angles."""
    made = []

    class Watched(SimRobot):
        def __init__(self, *args, **how):
            super().__init__(*args, **how)
            self.course, self.commands = [], []
            made.append(self)

        def write(self, command):
            super().write(command)
            if command.powered[0]:
                self.course.append(self.plant.q[0].copy())
                self.commands.append(command.q[0].copy())

    monkeypatch.setattr("deploy.backends.sim.backend.SimRobot", Watched)
    return made


@pytest.fixture
def jog(call, monkeypatch, tmp_path):
    """Call deploy-run --policy jog with a text of keys."""
    monkeypatch.setattr(deploy.operation.session, "ConsoleProcess", NoScreen)

    def run(keys, *arguments):
        reading, writing = os.pipe()
        os.write(writing, keys.encode())
        os.close(writing)
        with os.fdopen(reading) as stream:
            monkeypatch.setattr(sys, "stdin", stream)
            options = ("--policy", "jog", "--speed", "max", "--out", tmp_path / "out", *arguments)
            return call(deploy.operation.cli.cli, *options)

    return run


def moved(robot, begin=0, end=-1):
    return robot.commands[end] - robot.commands[begin]


def test_keys_move_one_joint_after_another(jog, robots, tmp_path):
    wait = "." * 30
    code, *_ = jog("1" + "+" * 40 + wait + "3" + "\x1b[D" * 40 + wait + "\x1b[B" + "=" + wait + "q")
    assert code == 0
    robot = robots[0]
    held = 40 * 0.02 * SPEED[0]  # and a step that begins with the last press
    expected = [held + STEP_RAD, 0.0, -held - STEP_RAD, STEP_RAD, 0.0, 0.0]
    np.testing.assert_allclose(moved(robot), expected, atol=0.02 * SPEED[0] + 1e-6)
    np.testing.assert_allclose(robot.course[-1] - robot.course[0], expected, atol=0.005)
    speed = np.abs(np.diff(robot.commands, axis=0)).max(axis=0) / SPEC.dt
    assert (speed <= SPEED * (1 + 1e-6)).all()
    assert speed[0] > 0.9 * SPEED[0]
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["ended"], summary["policy"], summary["robot_digest"]) == ("done", "jog", SPEC.digest)
    assert (tmp_path / "out" / "run.mcap").stat().st_size > 10_000


def test_lines_of_the_console_tell_the_chosen_joint(jog, robots, monkeypatch):
    lines = []

    class Lines(NoScreen):
        def offer(self, snapshot):
            lines.append(line(snapshot))

    monkeypatch.setattr(deploy.operation.session, "ConsoleProcess", Lines)
    jog("3" + "+" * 20 + "." * 30 + "q")
    assert "shoulder_pan +0.0°" in lines[0]
    last = np.rad2deg(robots[0].course[-1][2])
    name, angle = re.search(r"(\w+) ([-+][\d.]+)°", lines[-1]).groups()
    assert (name, float(angle)) == ("elbow", pytest.approx(last, abs=0.2))


def test_space_stops_and_the_end_of_the_input_ends(jog, robots):
    """Without the space, the step of the last press would be completed."""
    jog("1" + "+" * 20 + " " + "." * 30)
    jog("1" + "+" * 20 + "." * 31)
    stopped, completed = (moved(robot)[0] for robot in robots)
    assert 0 < stopped < completed - 0.5 * STEP_RAD


def test_other_robots_are_jogged_too(jog, robots, tmp_path):
    """A robot without tool and workspace, and one with a floating base."""
    no_force = (r"(?s)\[sensors.force\].*?(?=\[sensors.goal\])", "")
    bare = copy_of_arm(tmp_path, toml=(*NO_TOOL, no_force))
    assert load_robot(bare).capabilities == {"self_collision"}
    for folder in (bare, TEST_ROBOTS / "quadruped"):
        code, said, complaint = jog(
            "2" + "+" * 25 + "." * 20 + "q", "--robot", folder, "--out", tmp_path / folder.name
        )
        assert (code, complaint) == (0, ""), said
        far = np.abs(moved(robots[-1]))
        assert far[1] > 1.5 * STEP_RAD
        assert np.delete(far, 1).max() < 1e-6


def test_keys_do_not_act_after_a_stop(jog, robots, monkeypatch):
    """A robot that stopped for a reason of category 2 does not complete the motion when it goes on."""
    read, silent = SimRobot.read, [12]  # ticks without packets, in the middle of the step

    def lossy(robot):
        sample = read(robot)
        if silent[0] and robot.commands and moved(robot)[0] > 0.2 * STEP_RAD:
            silent[0] -= 1
            sample["encoder"].fresh[:] = False
        return sample

    monkeypatch.setattr(SimRobot, "read", lossy)
    code, said, _ = jog("1+" + "." * 80 + "q")
    assert code == 0
    assert "sensor samples are missing" in said
    assert 0 < moved(robots[0])[0] < STEP_RAD - 0.002


def test_keys_of_a_terminal_do_not_wait_until_the_robot_is_armed(call, monkeypatch, tmp_path):
    """Pressed too early they would move it as soon as it has power."""
    monkeypatch.setattr(deploy.operation.session, "ConsoleProcess", NoScreen)
    ours, theirs = os.openpty()
    keys, made = {5: b"+", 8: b"+", 150: b"2-", 220: b"q"}, []

    class Typed(SimRobot):
        def write(self, command):
            super().write(command)
            made.append(command.q[0].copy())
            os.write(ours, keys.get(len(made), b""))

    monkeypatch.setattr("deploy.backends.sim.backend.SimRobot", Typed)
    with os.fdopen(theirs) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        options = ("--policy", "jog", "--speed", "max", "--out", tmp_path / "out")
        assert call(deploy.operation.cli.cli, *options)[0] == 0
    os.close(ours)
    far = made[-1] - made[100]
    assert far[1] == pytest.approx(-STEP_RAD, abs=1e-6)
    assert np.abs(np.delete(far, 1)).max() < 1e-6
    assert len(made) < 240


def test_end_before_the_robot_is_armed_ends_the_run(call, monkeypatch, tmp_path):
    monkeypatch.setattr(deploy.operation.session, "ConsoleProcess", NoScreen)
    ours, theirs = os.openpty()
    commands = []

    class Typed(SimRobot):
        def write(self, command):
            super().write(command)
            commands.append(command)
            os.write(ours, b"q" if len(commands) == 3 else b"")

    monkeypatch.setattr("deploy.backends.sim.backend.SimRobot", Typed)
    with os.fdopen(theirs) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        options = ("--policy", "jog", "--speed", "max", "--out", tmp_path / "out")
        assert call(deploy.operation.cli.cli, *options)[0] == 0
    os.close(ours)
    assert len(commands) < 50


def test_reduced_speed_is_a_limit_of_the_robot():
    slow = reduced_speed(SPEC)
    assert slow.margins.speed == 0.05 * SPEC.margins.speed
    assert slow.margins.tool_speed == SPEC.margins.tool_speed
    assert slow.workspace.tool_speed_max == TOOL_SPEED
    assert slow.margins.oscillation_hz is None
    usual = {"joints": SPEC.joints, "workspace": SPEC.workspace, "margins": SPEC.margins}
    assert slow.model_copy(update=usual) == SPEC


def test_a_motion_ends_where_it_was_asked_to():
    jog, all_ = Jog(reduced_speed(SPEC)), np.zeros((1, 6), np.float32)
    jog.move(2, -0.1)
    steps = np.array([jog.step(all_) for _ in range(200)])[:, 0] * jog.contract.action.scale
    np.testing.assert_allclose(steps.sum(axis=0), [0, 0, -0.1, 0, 0, 0], atol=1e-9)
    assert np.abs(steps).max() <= SPEED[0] * SPEC.dt * (1 + 1e-6)
    jog.move(2, 0.1)
    jog.move(1, 0.1)
    assert jog.to_go.tolist() == [[0, 0.1, 0, 0, 0, 0]]


def test_a_file_of_that_name_is_not_hidden(jog, call, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    saved(policy_model(), tmp_path).rename(tmp_path / "jog")
    code, _, complaint = jog("q")
    assert code == 2
    assert "--policy jog: found a file of that name, expected ./jog for it, or none here" in complaint
    options = ("--policy", "./jog", "--speed", "max", "--duration", 0.3, "--out", tmp_path / "out")
    assert call(deploy.operation.cli.cli, *options)[0] == 0
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["policy"] == "./jog"


def test_terminal_is_restored_after_bad_input(call, monkeypatch, tmp_path):
    ours, theirs = os.openpty()
    with os.fdopen(theirs) as stream:
        before = termios.tcgetattr(stream)
        monkeypatch.setattr(sys, "stdin", stream)
        (tmp_path / "out").write_text("mine")
        run = partial(call, deploy.operation.cli.cli, "--policy", "jog", "--out", tmp_path / "out")
        assert run()[0] == 2
        assert termios.tcgetattr(stream) == before
    os.close(ours)
