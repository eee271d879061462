import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from test_clock import FakeTime
from test_contract import SWAPPED, arm_contract
from test_policy import policy_model, saved

import deploy.run
from deploy import show
from deploy.backends.sim.robot import SimRobot
from deploy.clock import WallClock
from deploy.pace import Pace
from deploy.policy import Policy
from deploy.recorder import Recorder
from deploy.runtime import Runtime
from deploy.screen import Screen
from deploy.shift import Ending, Shift
from deploy.state import Mode, Reason
from robots.randomness import robot_seed
from robots.spec import load_robot

SPEC = load_robot("arm6")


class Watched(SimRobot):
    """A simulated robot that remembers what it was told."""

    def __init__(self, *args):
        super().__init__(*args)
        self.sent, self.cut = [], 0

    def write(self, command):
        powered = bool(command.powered[0])
        self.sent.append((powered, np.concatenate((command.q[0], command.qd[0], command.tau[0]))))
        super().write(command)

    def stop(self, ids):
        self.cut += 1
        super().stop(ids)


class Bench:
    """A whole run but for the wall's time; `at` maps a tick to what happens while waiting for it."""

    def __init__(self, folder, policy, *, duration=1.0, at=None):
        seeds = [robot_seed(7, 0)]
        self.time, self.at, self.slots = FakeTime(), at or {}, 0
        self.robot, self.policy = Watched(SPEC, seeds), Policy.load(policy, SPEC)
        self.runtime = Runtime(SPEC, self.policy.contract, self.robot, seeds, self.policy)
        clock = WallClock(SPEC.dt, now=self.time.now, sleep=self.sleep)
        self.pace = Pace(clock, SPEC.rates.control_hz, now=self.time.now)
        self.recorder = Recorder(folder, self.runtime, start_ns=0, about={})
        self.shift = Shift(self.runtime, self.pace, self.recorder, duration=duration)

    def sleep(self, seconds):
        self.time.sleep(seconds)
        self.slots += 1
        self.at.get(self.slots, lambda: None)()

    def live(self):
        try:
            return self.shift.live()
        finally:
            self.recorder.close()

    def planned(self):
        """(T, 3 n): q, qd and torque of every command that was sent with the drives on."""
        return np.array([numbers for powered, numbers in self.robot.sent if powered])


@pytest.fixture
def bench(tmp_path, arm_policy, quick_goals):
    return lambda **kwargs: Bench(tmp_path, arm_policy, **kwargs)


def comes_to_rest(b):
    """The last commands were a controlled stop: within limits, and at rest before power went."""
    n, sent = SPEC.n, b.planned()
    speed = sent[:, n : 2 * n]
    jump = np.abs(np.diff(speed, axis=0)).max(axis=0) / SPEC.dt
    return (
        b.runtime.supervisor.mode[0] == Mode.LATCHED
        and not b.robot.sent[-1][0]
        and np.abs(speed[-1]).max() < 1e-9
        and (jump <= SPEC.joint_array("qdd_max") * (1 + 1e-6)).all()
    )


def moves(b, monkeypatch, action=1.0):
    """Let the policy swing the first joint."""
    say = np.zeros((1, SPEC.n), np.float32)
    say[0, 0] = action
    monkeypatch.setattr(b.policy, "step", lambda observation: say)


# ---- how a shift ends ----


def test_a_shift_arms_works_and_comes_to_rest(bench):
    b = bench(duration=1.0)
    assert b.live() is Ending.DONE
    assert comes_to_rest(b)
    powered = [powered for powered, _ in b.robot.sent]
    assert 200 <= sum(powered) <= 210
    assert not powered[0]
    assert (b.robot.cut, b.pace.skipped) == (0, 0)
    assert b.shift.tally.stops == {"operator": 1}
    assert b.recorder.events == ()


def test_a_moving_arm_is_brought_to_rest_at_the_end(bench, monkeypatch):
    b = bench(duration=0.6)
    moves(b, monkeypatch)
    assert b.live() is Ending.DONE
    assert comes_to_rest(b)
    assert np.abs(b.planned()[:, SPEC.n]).max() > 0.5  # rad/s: it did move


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_none_stop_the_robot_and_are_never_sent(bench, monkeypatch, bad):
    b = bench(duration=60.0)
    say = np.zeros((1, SPEC.n), np.float32)
    say[0, 0] = 1.0
    monkeypatch.setattr(b.policy, "step", lambda observation: say)
    b.at[100] = lambda: say.__setitem__((0, 3), bad)
    assert b.live() is Ending.STOPPED
    assert comes_to_rest(b)
    assert np.isfinite([numbers for _, numbers in b.robot.sent]).all()
    assert b.runtime.supervisor.reason[0] & Reason.NOT_FINITE
    assert b.shift.tally.stops["not_finite"] == 1
    assert 100 < b.runtime.ticks < 200
    assert len(b.recorder.events) == 1
    assert b.robot.cut == 0


@pytest.mark.parametrize("which", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_first_interrupt_is_a_controlled_stop(bench, monkeypatch, which):
    b = bench(duration=60.0)
    moves(b, monkeypatch)
    b.at[100] = lambda: signal.raise_signal(which)
    before = signal.getsignal(which)
    assert b.live() is Ending.INTERRUPTED
    assert signal.getsignal(which) is before
    assert comes_to_rest(b)
    assert 100 < b.runtime.ticks < 200
    assert (b.robot.cut, len(b.recorder.events)) == (0, 1)


@pytest.mark.parametrize("second", [signal.SIGHUP, signal.SIGTERM])
def test_a_terminal_that_closes_twice_is_still_a_controlled_stop(bench, monkeypatch, second):
    b = bench(duration=60.0)
    moves(b, monkeypatch)
    b.at[100] = lambda: [signal.raise_signal(which) for which in (signal.SIGHUP, second)]
    assert b.live() is Ending.INTERRUPTED
    assert comes_to_rest(b)
    assert b.robot.cut == 0


def test_an_interrupt_while_arming_moves_nothing(bench):
    b = bench(duration=60.0)
    b.at[5] = lambda: signal.raise_signal(signal.SIGINT)
    assert b.live() is Ending.INTERRUPTED
    assert np.ptp(b.planned(), axis=0).max() == 0.0
    assert b.runtime.ticks < 12


def test_whoever_asks_again_later_is_heard(bench, monkeypatch):
    """A service manager knows no Ctrl-C."""
    b = bench(duration=60.0)
    moves(b, monkeypatch)
    monkeypatch.setattr(b.shift.interrupts, "_now", b.time.now)
    b.at[100] = lambda: signal.raise_signal(signal.SIGTERM)
    b.at[103] = lambda: (b.time.sleep(0.6), signal.raise_signal(signal.SIGTERM))
    with pytest.raises(KeyboardInterrupt):
        b.live()
    assert (b.robot.cut, b.shift.ending) == (1, Ending.FAILED)


@pytest.mark.parametrize("first", [signal.SIGINT, signal.SIGTERM])
def test_a_second_interrupt_cuts_power(bench, monkeypatch, first):
    b = bench(duration=60.0)
    moves(b, monkeypatch)
    b.at[100] = lambda: signal.raise_signal(first)
    b.at[103] = lambda: signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        b.live()
    assert (b.robot.cut, b.shift.ending) == (1, Ending.FAILED)
    assert b.robot.plant.braked.all()
    assert b.runtime.ticks <= 104


def test_what_nobody_expected_cuts_power_and_is_raised(bench, monkeypatch):
    b = bench(duration=60.0)

    def fail():
        raise ZeroDivisionError("a fault in the code")

    b.at[150] = fail
    with pytest.raises(ZeroDivisionError, match="a fault in the code"):
        b.live()
    assert (b.robot.cut, b.shift.ending) == (1, Ending.FAILED)
    assert b.robot.plant.braked.all()
    assert len(b.recorder.events) == 1


def test_a_stop_that_does_not_end_cuts_power(bench, monkeypatch):
    b = bench(duration=0.5)
    monkeypatch.setattr(type(b.runtime.smoother), "at_rest", np.zeros(1, dtype=bool))
    with pytest.raises(RuntimeError, match=r"no rest within 4.5 s of asking for a stop"):
        b.live()
    assert b.robot.cut == 1


@pytest.mark.parametrize(("lost_s", "ending"), [(0.101, Ending.DONE), (0.2, Ending.STOPPED)])
def test_too_many_late_ticks_stop_the_robot(bench, lost_s, ending):
    b = bench(duration=1.0)
    b.at[100] = lambda: b.time.sleep(lost_s)
    assert b.live() is ending
    assert comes_to_rest(b)
    assert b.pace.skipped == round(lost_s / SPEC.dt)
    assert ("overrun" in b.shift.tally.stops) is (ending is Ending.STOPPED)


def test_a_robot_that_is_too_hot_is_not_armed(bench):
    b = bench()
    b.robot.plant.housing[:] = 95.0
    assert b.live() is Ending.REFUSED
    assert b.shift.reason == "a motor housing is too hot"
    assert not any(powered for powered, _ in b.robot.sent)


# ---- the command ----


class Blind:
    """A screen nobody looks at."""

    def offer(self, snapshot):
        json.dumps(snapshot)

    def close(self):
        """Nothing to close."""


@pytest.fixture
def command(monkeypatch, capsys):
    """Run the command line; return its exit code and what it said."""
    monkeypatch.setattr(deploy.run, "Show", Blind)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["deploy-run", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            deploy.run.cli()
        said = capsys.readouterr()
        return caught.value.code, said.out, said.err

    return run


@pytest.mark.usefixtures("quick_goals")
def test_a_run_leaves_a_summary(command, arm_policy, tmp_path):
    out = tmp_path / "a" / "b"
    code, said, complaint = command(
        "--policy", arm_policy, "--duration", 4.5, "--speed", "max", "--seed", 3, "--out", out
    )
    summary = json.loads((out / "summary.json").read_text())
    assert (code, complaint) == (0, "")
    assert (summary["ended"], summary["seed"], summary["stops"]) == ("done", "3", {"operator": 1})
    assert (summary["robot_digest"], summary["recording"]) == (SPEC.digest, str(out / "run.mcap"))
    assert summary["policy_digest"] == Policy.load(arm_policy, SPEC).digest
    assert summary["goals"]["attempted"] == 1
    assert 900 <= summary["ticks"] <= 906
    assert 15 < summary["housing_max_c"] < 60
    assert "0 of 1 reached" in said
    assert {path.name for path in out.iterdir()} == {"run.mcap", "summary.json"}


@pytest.mark.usefixtures("quick_goals")
def test_a_robot_that_is_not_armed_is_exit_1(command, arm_policy, tmp_path, monkeypatch):
    class Hot(SimRobot):
        def __init__(self, *args):
            super().__init__(*args)
            self.plant.housing[:] = 95.0

    monkeypatch.setattr("deploy.backends.sim.robot.SimRobot", Hot)
    code, said, _ = command("--policy", arm_policy, "--speed", "max", "--out", tmp_path)
    assert code == 1
    assert "not armed: a motor housing is too hot" in said
    assert json.loads((tmp_path / "summary.json").read_text())["ended"] == "not armed"


@pytest.mark.usefixtures("quick_goals")
def test_an_interrupted_run_is_exit_130_and_keeps_what_it_has(command, arm_policy, tmp_path, monkeypatch):
    waits = iter(range(10_000))

    def wait(_):
        if next(waits) == 300:
            signal.raise_signal(signal.SIGINT)
        return 0.0

    monkeypatch.setattr("deploy.clock.Unpaced.wait", wait)
    assert command("--policy", arm_policy, "--speed", "max", "--out", tmp_path)[0] == 130
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["ended"], summary["reason"]) == ("interrupted", "the operator asked for it")
    assert [Path(event).name for event in summary["events"]] == ["event-300.mcap"]


def test_a_defect_is_exit_70_with_its_traceback(command, arm_policy, tmp_path, monkeypatch):
    """1 would be a verdict."""

    def fails(self, action):
        raise ZeroDivisionError("of ours")

    monkeypatch.setattr(Runtime, "act", fails)
    code, _, complaint = command("--policy", arm_policy, "--out", tmp_path)
    assert code == 70
    assert complaint.rstrip().endswith("ZeroDivisionError: of ours")


def swapped(folder):
    return saved(policy_model(arm_contract(joint_names=SWAPPED)), folder)


def for_another_robot(folder):
    return saved(policy_model(arm_contract(robot="planar3")), folder)


def missing(folder):
    return folder / "no.onnx"


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (missing, "no.onnx: cannot be read: No such file or directory, expected an ONNX policy"),
        (for_another_robot, "policy.onnx: contract: robot: found 'planar3', expected 'arm6'"),
        (swapped, "policy.onnx: contract: joint_names: the right joints in another order: found"),
    ],
)
def test_a_bad_policy_is_exit_2_and_nothing_is_made(command, tmp_path, policy, message):
    out = tmp_path / "out"
    code, said, complaint = command("--policy", policy(tmp_path), "--out", out)
    assert (code, said) == (2, "")
    assert complaint.startswith(f"error: {tmp_path}")
    assert message in complaint
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--robot", "arm7"), "error: --robot arm7: no such folder with a robot.toml; known: arm6"),
        (("--backend", "canopen"), "error: --backend canopen: unknown; known: sim"),
        (("--speed", "fast"), "error: --speed fast: expected a factor above 0 and at most 1000, or max"),
        (("--speed", "0"), "error: --speed 0: expected a factor above 0"),
        (("--speed", "nan"), "error: --speed nan: expected a factor above 0"),
        (("--speed", "inf"), "error: --speed inf: expected a factor above 0"),
        (("--speed", "-1"), "error: --speed -1: expected a factor above 0"),
        (("--duration", "0"), "error: --duration 0.0: expected s above 0, or inf"),
        (("--duration", "nan"), "error: --duration nan: expected s above 0, or inf"),
        (("--duration", "long"), "Invalid value for '--duration'"),
        (("--seed", "-3"), "error: --seed -3: expected 0 or more"),
        (("--sped", "2"), "No such option: --sped"),
    ],
)
def test_a_bad_option_is_exit_2_and_nothing_is_made(command, arm_policy, tmp_path, arguments, message):
    out = tmp_path / "out"
    code, said, complaint = command("--policy", arm_policy, "--out", out, *arguments)
    assert (code, said) == (2, "")
    assert message in complaint
    assert not out.exists()


def test_without_an_option_the_policy_is_the_one_that_make_export_writes(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, complaint = command()
    assert code == 2
    assert "out/arm.onnx: cannot be read" in complaint


def test_a_place_that_cannot_be_written_is_exit_2_and_left_alone(command, arm_policy, tmp_path):
    (tmp_path / "out").write_text("mine")
    code, _, complaint = command("--policy", arm_policy, "--out", tmp_path / "out")
    assert code == 2
    assert (
        complaint == f"error: --out {tmp_path / 'out'}: cannot be written: File exists, expected a folder\n"
    )
    assert (tmp_path / "out").read_text() == "mine"


def test_a_view_without_a_display_is_exit_2(command, arm_policy, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    code, _, complaint = command("--policy", arm_policy, "--out", tmp_path, "--view")
    assert code == 2
    assert "--view: found neither DISPLAY nor WAYLAND_DISPLAY, expected a display" in complaint
    assert list(tmp_path.iterdir()) == []


def test_the_real_thing_needs_no_torch_and_speaks_in_lines(arm_policy, tmp_path):
    code = (
        "import sys, deploy.run\n"
        "try: deploy.run.cli()\n"
        "finally: sys.exit(99) if 'torch' in sys.modules else None"
    )
    arguments = ["--policy", arm_policy, "--duration", "1", "--speed", "max", "--out", tmp_path]
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    first, *_, last = done.stdout.partition("\nended")[0].splitlines()
    assert "DISARMED" in first
    assert "LATCHED" in last


# ---- the picture ----


class Window:
    """Stands in for MuJoCo's viewer."""

    def __init__(self, model, data):
        self.data, self.synced, self.open = data, [], True

    def is_running(self):
        return self.open

    def lock(self):
        return contextlib.nullcontext()

    def sync(self):
        self.synced.append(self.data.qpos.copy())


def test_the_view_follows_the_true_pose_until_it_is_closed(monkeypatch):
    from deploy.backends.sim import view

    windows = []
    monkeypatch.setattr(view, "_check_display", lambda: None)
    monkeypatch.setattr(
        view.mujoco.viewer, "launch_passive", lambda *args: windows.append(Window(*args)) or windows[0]
    )
    robot = SimRobot(SPEC, [robot_seed(7, 0)])
    seen, pose = view.View(robot), SPEC.joint_array("q_home") + 0.1
    robot.reset(np.ones(1, dtype=bool), pose[None])
    seen.step()
    windows[0].open = False
    seen.step()
    np.testing.assert_array_equal(windows[0].synced, [pose])


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
    "joints": [["elbow", 1.5, -0.25, 0.0012, 33.3, 61.0, 80.0], ["wrist_1", 0.1, 0, 0, 0, 24.0, 80.0]],
}


def drawn(snapshots, terminal):
    with open(os.devnull, "w") as nowhere:
        console = Console(file=nowhere, force_terminal=terminal, record=True, width=100)
        show.follow([json.dumps(s) + "\n" for s in snapshots] + ['{"cut'], console)
        return console.export_text()


def test_the_table_shows_everything():
    text = drawn([SNAPSHOT], terminal=True)
    for part in (
        *("HOLDING samples are missing", "12.3 s, 7.7 s left", "200 Hz of 200, 3 slots skipped"),
        *("p50 55 µs, p99 410 µs, max 2100 µs", "2 of 3 reached", "11.20 s: samples are missing"),
        *("elbow", "+1.500", "-0.250", "+1.2", "+33.3", "61", "80", "No space left on device"),
    ):
        assert part in text


def test_lines_come_once_a_second_and_with_news():
    quiet = {**SNAPSHOT, "notes": [], "mode": "RUNNING", "reason": ""}
    snapshots = [{**quiet, "elapsed": k / 5} for k in range(15)]
    text = drawn([*snapshots, {**SNAPSHOT, "elapsed": 2.9}, {**SNAPSHOT, "elapsed": 2.95}], terminal=False)
    lines = text.splitlines()
    assert lines[:3] == ["12.3 s  RUNNING  200 Hz  3 skipped  goals 2/3  61 °C"] * 3
    assert lines[3:] == [
        "12.3 s  HOLDING  200 Hz  3 skipped  goals 2/3  61 °C  samples are missing",
        "note: run.mcap: cannot be written: No space left on device",
    ]


def test_a_screen_that_is_not_read_holds_nothing_up_and_tears_no_line():
    reading, writing = os.pipe()
    screen, text = Screen(writing), {"x": "y" * 5000}  # longer than what a pipe takes whole
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


def test_a_screen_that_has_gone_is_forgotten():
    reading, writing = os.pipe()
    screen = Screen(writing)
    os.close(reading)
    for _ in range(3):
        screen.offer({})
    screen.close()
