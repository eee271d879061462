import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from rich.console import Console

from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.scene import Scene
from deploy.telemetry import console_display
from deploy.telemetry.console import ConsoleProcess, SnapshotPipe
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.walking import QUADRUPED, live, walker

SPEC = load_robot("arm6")


class Window:
    """Stands in for MuJoCo's viewer."""

    def __init__(self, model, data):
        self.data, self.synced, self.open = data, [], True
        self.cam, self.user_scn = SimpleNamespace(lookat=np.zeros(3)), mujoco.MjvScene(model, 10)
        self.opt = mujoco.MjvOption()

    def is_running(self):
        return self.open

    def close(self):
        self.open = False

    def lock(self):
        return contextlib.nullcontext()

    def sync(self):
        self.synced.append(self.data.qpos.copy())


def test_the_view_follows_the_true_pose_until_it_is_closed(monkeypatch):
    from deploy.backends.sim import view

    windows = []
    monkeypatch.setattr(view, "check_display", lambda _: None)
    monkeypatch.setattr(
        view.mujoco.viewer, "launch_passive", lambda *args: windows.append(Window(*args)) or windows[0]
    )
    robot = SimRobot(SPEC, [robot_seed(7, 0)])
    seen, pose = view.View(robot), SPEC.joint_array("q_home") + 0.1
    robot.reset(np.ones(1, dtype=bool), pose[None])
    seen.step()
    assert windows[0].user_scn.ngeom == 0
    robot.goal[:] = goal = [0.3, 0.1, 0.4]
    for _ in range(2):
        seen.step()
    assert windows[0].user_scn.ngeom == 1
    np.testing.assert_allclose(windows[0].user_scn.geoms[0].pos, goal, rtol=1e-6)
    assert windows[0].opt.geomgroup.all()
    seen.close()
    assert not windows[0].open
    seen.step()
    np.testing.assert_array_equal(windows[0].synced, [pose] * 3)


def test_view_follows_a_walking_robot(monkeypatch):
    from deploy.backends.sim import view

    windows = []
    monkeypatch.setattr(view, "check_display", lambda _: None)
    monkeypatch.setattr(
        view.mujoco.viewer, "launch_passive", lambda *args: windows.append(Window(*args)) or windows[0]
    )
    runtime = walker(1)
    live(runtime, 3)
    view.View(runtime.robot).step()
    truth = runtime.robot.truth()
    place = truth.base.position[0]
    assert place[2] > 0.1
    np.testing.assert_array_equal(windows[0].cam.lookat, place)
    np.testing.assert_array_equal(
        windows[0].synced, [np.concatenate((place, truth.base.quat_wxyz[0], truth.q[0]))]
    )


def test_a_scene_has_one_floor(tmp_path):
    """Its own, or else one to walk on; an arm stands on its table."""
    tiled = shutil.copytree(QUADRUPED.folder, tmp_path / "tiled")
    text = (tiled / "model.xml").read_text()
    assert "plane" not in text
    floor = '<worldbody><geom name="tiles" type="plane" size="5 5 1"/>'
    (tiled / "model.xml").write_text(text.replace("<worldbody>", floor))
    kinds = [Scene(spec).model.geom_type for spec in (QUADRUPED, load_robot(tiled), SPEC)]
    assert [np.count_nonzero(kind == mujoco.mjtGeom.mjGEOM_PLANE) for kind in kinds] == [1, 1, 0]


SNAPSHOT = {
    "title": "arm6",
    "t": 12.34,
    "elapsed": 12.5,
    "left": 7.66,
    "mode": "HOLDING",
    "reason": "samples are missing",
    "rate": 199.6,
    "hz": 200.0,
    "late_us": [55.0, 410.0, 2100.0],
    "skipped": 3,
    "reached": 2,
    "attempted": 3,
    "stops": ["11.20 s: samples are missing"],
    "notes": ["run.mcap: cannot be written: No space left on device"],
    "joint": None,
    "joints": [
        ["elbow", 1.5, -0.25, 0.0012, 33.3, 61.0, 60.0, 80.0, 111.0, 80.0, 110.0],
        ["wrist_1", 0.1, 0, 0, 0, 24.0, 60.0, 80.0, 25.0, 80.0, 110.0],
    ],
}


def drawn(snapshots, terminal):
    with open(os.devnull, "w") as nowhere:
        console = Console(file=nowhere, force_terminal=terminal, record=True, width=100)
        console_display.follow([json.dumps(s) + "\n" for s in snapshots] + ['{"cut'], console)
        return console.export_text()


def test_the_table_shows_everything():
    text = drawn([SNAPSHOT], terminal=True)
    for part in (
        *("HOLDING samples are missing", "12.3 s, 7.7 s left", "200 Hz of 200, 3 slots skipped"),
        *("p50 55 µs, p99 410 µs, max 2100 µs", "2 of 3 reached", "11.20 s: samples are missing"),
        *("elbow", "+1.500", "-0.250", "+1.2", "+33.3", "61 of 80", "111 of 110", "No space left on device"),
    ):
        assert part in text


@pytest.mark.parametrize(
    ("encoding", "degree"), [("ascii", b"\\xb0C"), ("utf-16-le", "°C".encode("utf-16-le"))]
)
def test_letters_are_written_as_the_output_has_them(monkeypatch, capfdbinary, encoding, degree):
    """Or escaped, where it lacks them."""
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(io.BytesIO(), encoding=encoding))
    console = ConsoleProcess()
    console.offer(SNAPSHOT)
    console.close()
    out, err = capfdbinary.readouterr()
    assert (degree in out, err) == (True, b"")


PARENT = """
import json, sys, time
from deploy.telemetry.console import ConsoleProcess
console = ConsoleProcess()
console.offer(json.loads(sys.argv[1]))
print("offered", file=sys.stderr, flush=True)
time.sleep(3600)
"""


@pytest.fixture
def full_pipe():
    """Writing end of a pipe that takes no more; a process that waits to write to it goes on when the test ends."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(4096))
    os.set_blocking(writing, True)
    yield writing
    os.close(writing)
    os.close(reading)


def test_a_display_whose_output_nobody_reads_ends_with_a_killed_parent(full_pipe):
    """Standard error is a pipe, too: it ends when neither of them is left."""
    command = [sys.executable, "-c", PARENT, json.dumps(SNAPSHOT)]
    with subprocess.Popen(command, stdout=full_pipe, stderr=subprocess.PIPE, text=True) as parent:
        try:
            assert parent.stderr.readline() == "offered\n"
        finally:
            parent.send_signal(signal.SIGKILL)
        assert parent.communicate(timeout=60.0) == (None, "")


def test_lines_appear_once_a_second_and_on_changes():
    quiet = {**SNAPSHOT, "notes": [], "mode": "RUNNING", "reason": ""}
    snapshots = [{**quiet, "elapsed": k / 5} for k in range(15)]
    text = drawn([*snapshots, {**SNAPSHOT, "elapsed": 2.9}, {**SNAPSHOT, "elapsed": 2.95}], terminal=False)
    lines = text.splitlines()
    assert lines[:3] == ["12.3 s  RUNNING  200 Hz  3 skipped  goals 2/3  61 °C"] * 3
    assert lines[3:] == [
        "12.3 s  HOLDING  200 Hz  3 skipped  goals 2/3  61 °C  samples are missing",
        "note: run.mcap: cannot be written: No space left on device",
    ]


def test_a_note_is_printed_once():
    notes = [*SNAPSHOT["notes"], "another"]
    later = [{**SNAPSHOT, "notes": notes}, {**SNAPSHOT, "notes": notes, "mode": "LATCHED"}]
    lines = drawn([SNAPSHOT, *later], terminal=False).splitlines()
    assert [line for line in lines if line.startswith("note: ")] == [f"note: {note}" for note in notes]


def test_lines_name_the_joint_that_the_operator_moves():
    """One for each change of the joint."""
    quiet = {**SNAPSHOT, "notes": [], "mode": "RUNNING", "reason": ""}
    text = drawn([{**quiet, "joint": joint} for joint in (0, 0, 1)], terminal=False)
    assert text.splitlines() == [
        "12.3 s  RUNNING  200 Hz  3 skipped  goals 2/3  61 °C  elbow +85.9°",
        "12.3 s  RUNNING  200 Hz  3 skipped  goals 2/3  61 °C  wrist_1 +5.7°",
    ]


def test_blocked_terminal_delays_nothing_and_tears_no_line():
    reading, writing = os.pipe()
    screen, text = SnapshotPipe(writing), {"x": "y" * 5000}  # longer than what a pipe takes whole
    for k in range(1000):  # far more than a pipe takes
        screen.offer({"k": k, **text})
    received = os.read(reading, 1 << 20)
    screen.offer({"k": 1000, **text})  # what is left of a line goes first
    screen.offer({"k": 1001, **text})
    screen.close()
    with open(reading, "rb") as rest:
        received += rest.read()
    numbers = [json.loads(line)["k"] for line in received.splitlines()]
    assert received.endswith(b"\n")
    assert numbers[-1] == 1001
    assert numbers == sorted(numbers)
    assert len(numbers) < 200


def test_closed_terminal_is_dropped():
    reading, writing = os.pipe()
    screen = SnapshotPipe(writing)
    os.close(reading)
    for _ in range(3):
        screen.offer({})
    screen.close()
