import json
import re
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import deploy.operation.cli
import deploy.operation.session
import deploy.operation.summary
from deploy.backends.sim.plant import Plant
from deploy.backends.sim.robot import SimRobot
from deploy.policy.policy import Policy
from deploy.runtime import Runtime
from deploy.start import BROKEN
from deploy.telemetry.folder_lock import LOCK, locked
from deploy.telemetry.recorder import Recorder
from robots.distributions import load_distributions
from robots.draws import draw
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.contracts import SWAPPED, arm_contract
from support.paths import ROOT
from support.planar import failing
from support.policies import policy_model, saved
from support.refusals import in_use
from support.screen import NoScreen

SPEC = load_robot("arm6")
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full")


@pytest.fixture
def command(call, monkeypatch):
    """`deploy-run` without a screen."""
    monkeypatch.setattr(deploy.operation.session, "ConsoleProcess", NoScreen)
    return partial(call, deploy.operation.cli.cli)


def test_a_run_leaves_a_summary(command, arm_policy, tmp_path):
    out = tmp_path / "a" / "b"
    code, said, complaint = command(
        "--policy", arm_policy, "--duration", 4.5, "--speed", "max", "--seed", 3, "--out", out
    )
    summary = json.loads((out / "summary.json").read_text())
    assert (code, complaint) == (0, "")
    assert (summary["ended"], summary["seed"], summary["stops"]) == ("done", "3", {"operator": 1})
    assert [re.sub(r"^[\d.]+ s: ", "", stop) for stop in summary["last_stops"]] == ["stopped by the operator"]
    assert (summary["robot_digest"], summary["recording"]) == (SPEC.digest, str(out / "run.mcap"))
    assert summary["policy_digest"] == Policy.load(arm_policy, SPEC).digest
    assert summary["goals"]["attempted"] == 1
    assert 940 <= summary["ticks"] <= 970  # 0.2 s before it is armed, and the stop
    assert 15 < summary["housing_max_c"] < 60
    assert -2 <= summary["winding_max_c"] - summary["housing_max_c"] < 10  # the sensor's noise and steps
    assert "0 of 1 reached" in said
    assert {path.name for path in out.iterdir()} == {"run.mcap", "summary.json", "heat.json"}


def test_paths_are_printed_as_they_are(command, arm_policy, tmp_path, monkeypatch):
    """But on one line: brackets are no markup."""
    monkeypatch.setenv("COLUMNS", "1000")
    out = tmp_path / "a[/x]:smile:\x9b"
    code, said, _ = command("--policy", arm_policy, "--duration", 0.1, "--speed", "max", "--out", out)
    assert code == 0
    assert f"{tmp_path}/a[/x]:smile:?/run.mcap" in said


def test_a_policy_that_fails_is_stopped_and_its_failure_told(command, tmp_path):
    policy = failing(tmp_path / "policy.onnx", 50)
    options = ("--robot", "planar3", "--policy", policy, "--duration", 5, "--speed", "max")
    code, _, complaint = command(*options, "--out", tmp_path / "run")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (code, complaint, summary["stops"]) == (1, "", {"not_finite": 1})
    assert "a number is not finite (the policy failed: " in summary["last_stops"][0]


@pytest.mark.parametrize("stored", [False, True])
def test_robot_of_a_soak_keeps_its_draw_noise_and_goals(command, arm_policy, tmp_path, monkeypatch, stored):
    """By its number, or from what the soak stored of it."""
    made, soaked = [], SimRobot(SPEC, [robot_seed(5, robot) for robot in range(4)])
    if stored:
        (tmp_path / "draws.json").write_text(soaked.draw.to_json(5, load_distributions(SPEC), SPEC))
    which = f"{tmp_path / 'draws.json'}:3" if stored else "5:3"

    class Seen(SimRobot):
        def __init__(self, *args, **how):
            super().__init__(*args, **how)
            made.append(self)

    monkeypatch.setattr("deploy.backends.sim.backend.SimRobot", Seen)
    code, *_ = command(
        "--policy", arm_policy, "--speed", "max", "--duration", 0.5, "--out", tmp_path, "--draw", which
    )
    assert code == 0
    assert json.loads((tmp_path / "summary.json").read_text())["seed"] == which
    for name, values in made[0].draw.items():
        np.testing.assert_array_equal(values[0], soaked.draw[name][3])
    np.testing.assert_array_equal(made[0].sensors.noise_keys[0], soaked.sensors.noise_keys[3])


@pytest.mark.skipif(sys.platform != "linux", reason="needs names that are not UTF-8")
def test_names_that_are_not_utf_8_are_recorded_with_question_marks(command, arm_policy, tmp_path):
    policy, draws = (tmp_path / f"a\udcff{suffix}" for suffix in (".onnx", ".json"))
    shutil.copy(arm_policy, policy)
    distributions = load_distributions(SPEC)
    draws.write_text(draw(distributions, SPEC, [robot_seed(7, 0)]).to_json(7, distributions, SPEC))
    options = ("--policy", policy, "--draw", f"{draws}:0", "--speed", "max", "--duration", 0.1)
    code, _, complaint = command(*options, "--out", tmp_path / "run")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (code, complaint) == (0, "")
    assert (summary["policy"], summary["seed"]) == (f"{tmp_path}/a?.onnx", f"{tmp_path}/a?.json:0")


def test_a_robot_that_is_not_armed_is_exit_1(command, arm_policy, tmp_path, monkeypatch):
    class Hot(SimRobot):
        def __init__(self, *args, **how):
            super().__init__(*args, **how)
            self.plant.housing[:] = 95.0
            self.settle_sensors(np.ones(1, dtype=bool))

    monkeypatch.setattr("deploy.backends.sim.backend.SimRobot", Hot)
    code, said, _ = command("--policy", arm_policy, "--speed", "max", "--out", tmp_path)
    assert code == 1
    assert "not armed: a motor is too hot" in said
    assert json.loads((tmp_path / "summary.json").read_text())["ended"] == "not armed"


@pytest.mark.parametrize("which", [signal.SIGINT, signal.SIGQUIT])
def test_an_interrupted_run_is_exit_130_and_keeps_what_it_has(
    command, arm_policy, tmp_path, monkeypatch, which
):
    waits = iter(range(10_000))

    def wait(_):
        if next(waits) == 300:
            signal.raise_signal(which)
        return 0.0

    monkeypatch.setattr("deploy.operation.loop_timing.Unpaced.wait", wait)
    assert command("--policy", arm_policy, "--speed", "max", "--out", tmp_path)[0] == 130
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["ended"], summary["reason"]) == ("interrupted", "stopped by the operator")
    assert [Path(event).name for event in summary["events"]] == ["event-300.mcap"]


def test_a_run_prints_once_its_files_are_complete_and_signals_end_it_again(
    command, arm_policy, tmp_path, monkeypatch
):
    """Printing may block until somebody reads the output."""
    seen = []

    def observed(*, console=deploy.operation.summary.plain_console):
        seen.append((signal.getsignal(signal.SIGINT), {path.name for path in tmp_path.iterdir()}))
        return console()

    monkeypatch.setattr(deploy.operation.summary, "plain_console", observed)
    before = signal.getsignal(signal.SIGINT)
    code, said, _ = command("--policy", arm_policy, "--duration", 0.1, "--speed", "max", "--out", tmp_path)
    assert (code, said.startswith("ended          done ")) == (0, True)
    assert seen == [(before, {"run.mcap", "summary.json", "heat.json"})]


def test_a_recording_that_fails_at_its_end_takes_no_other_file_with_it(
    command, arm_policy, tmp_path, monkeypatch
):
    def close(recorder, close=Recorder.close):
        close(recorder)
        raise RuntimeError("no such channel")

    monkeypatch.setattr(Recorder, "close", close)
    options = ("--policy", arm_policy, "--duration", 0.1, "--speed", "max", "--out", tmp_path)
    code, said, complaint = command(*options)
    assert code == BROKEN
    assert complaint.endswith("RuntimeError: no such channel\n")
    assert said.startswith("ended          done ")
    assert json.loads((tmp_path / "summary.json").read_text())["ended"] == "done"


def test_a_signal_while_a_policy_is_loaded_ends_the_command_at_once(
    command, arm_policy, tmp_path, monkeypatch
):
    """Nothing moves yet, and a robot with many shapes takes seconds to load."""

    def check(*_):
        signal.raise_signal(signal.SIGTERM)
        pytest.fail("the command went on")

    monkeypatch.setattr("deploy.operation.cli.check_step", check)
    (tmp_path / "summary.json").write_text("of an earlier run")
    assert command("--policy", arm_policy, "--out", tmp_path)[0] == 130
    assert (tmp_path / "summary.json").read_text() == "of an earlier run"


def test_a_signal_while_files_are_completed_loses_none(command, arm_policy, tmp_path, monkeypatch):
    def close(recorder, close=Recorder.close):
        signal.raise_signal(signal.SIGTERM)
        close(recorder)

    monkeypatch.setattr(Recorder, "close", close)
    options = ("--policy", arm_policy, "--duration", 0.5, "--speed", "max", "--out", tmp_path)
    assert command(*options)[0] == 0
    assert json.loads((tmp_path / "summary.json").read_text())["ended"] == "done"


FULL_DISK = """
import resource, sys
from deploy.operation.loop_timing import Unpaced
from {module} import cli
ticks = 0
def wait(clock):
    global ticks
    ticks += 1
    if ticks == 300:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
    return 0.0
Unpaced.wait = wait
cli()
"""
"""A command, and a disk that is full from tick 300 on."""


def on_full_disk(module, out, *options):
    """Run a command by `python -c`: exit code, output and errors."""
    command = [
        sys.executable,
        "-c",
        FULL_DISK.format(module=module),
        "--speed",
        "max",
        "--out",
        out,
        *options,
    ]
    return subprocess.run(list(map(str, command)), cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_full_disk_stops_no_robot_and_is_exit_1_with_what_was_lost(arm_policy, tmp_path):
    done = on_full_disk("deploy.operation.cli", tmp_path, "--policy", arm_policy, "--duration", 6)
    assert done.returncode == 1
    lost = {"recording": "run.mcap", "motor temperatures --out": "heat.json", "summary --out": "summary.json"}
    assert done.stderr.splitlines() == [
        f"error: not kept: {what} {tmp_path / name}: cannot be written: File too large"
        for what, name in lost.items()
    ]
    assert done.stdout.count("note: recording") == 1
    assert re.search(r"^ended +done", done.stdout, re.MULTILINE)
    assert re.search(r"^last stops +6\.\d\d s: stopped by the operator", done.stdout, re.MULTILINE)


@pytest.mark.slow
def test_full_disk_is_no_verdict_of_a_check_but_exit_1(tmp_path):
    done = on_full_disk("deploy.commissioning.cli", tmp_path, "--robot", "planar3", "--seed", 3)
    assert done.returncode == 1
    assert "passed" in done.stdout.splitlines()
    found = tmp_path / "check.json"
    assert f"error: not kept: report --out {found}: cannot be written: File too large\n" in done.stderr


@linux_only
@pytest.mark.parametrize("errors_too", [False, True])
@pytest.mark.slow
def test_standard_output_that_is_full_costs_no_run(arm_policy, tmp_path, errors_too):
    script = "from deploy.start import deploy_run; deploy_run()"
    options = ("--policy", arm_policy, "--speed", "max", "--duration", "1", "--out", tmp_path)
    command = [sys.executable, "-c", script, *map(str, options)]
    with open("/dev/full", "w") as full:
        errors = full if errors_too else subprocess.PIPE
        done = subprocess.run(command, stdout=full, stderr=errors, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0
    if not errors_too:
        assert done.stderr == "warning: standard output cannot be written: No space left on device\n"
    assert json.loads((tmp_path / "summary.json").read_text())["ended"] == "done"


@pytest.mark.slow
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
def test_bad_policy_is_exit_2_and_writes_nothing(command, tmp_path, policy, message):
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
        (("--speed", "fast"), "error: --speed fast: expected a factor from 0.1 to 1000, or max"),
        (("--speed", "\u0661"), "error: --speed \u0661: expected a factor from 0.1"),
        (("--speed", "0"), "error: --speed 0: expected a factor from 0.1"),
        (("--speed", "nan"), "error: --speed nan: expected a factor from 0.1"),
        (("--speed", "inf"), "error: --speed inf: expected a factor from 0.1"),
        (("--speed", "1e-308"), "error: --speed 1e-308: expected a factor from 0.1"),
        (("--speed", "-1"), "error: --speed -1: expected a factor from 0.1"),
        (("--duration", "0"), "error: --duration 0.0: expected s above 0, or inf"),
        (("--duration", "nan"), "error: --duration nan: expected s above 0, or inf"),
        (("--duration", "long"), "Invalid value for '--duration'"),
        (("--seed", "-3"), "error: --seed -3: expected 0 or more"),
        (("--draw", "7"), "error: --draw 7: expected SEED:ROBOT, or FILE:ROBOT of a soak's draws.json"),
        (("--draw", "7:\u0663"), "error: --draw 7:\u0663: expected SEED:ROBOT"),
        (("--out=",), "error: --out: found nothing, expected a value"),
        (("--policy", ""), "error: --policy: found nothing, expected a value"),
        (("--draw", "nothing.json:1"), "error: nothing.json: cannot be read"),
        (("--draw", "7:-1"), "error: --draw 7:-1: expected SEED:ROBOT"),
        (
            ("--draw", "7:1", "--seed", "7"),
            "error: --draw 7:1: found --seed 7 beside it, expected one of them",
        ),
        (("--sped", "2"), "No such option: --sped"),
    ],
)
def test_bad_option_is_exit_2_and_writes_nothing(command, arm_policy, tmp_path, arguments, message):
    out = tmp_path / "out"
    code, said, complaint = command("--policy", arm_policy, "--out", out, *arguments)
    assert (code, said) == (2, "")
    assert message in complaint
    assert not out.exists()


def test_temperatures_persist_between_runs_except_for_a_drawn_robot(
    command, arm_policy, tmp_path, monkeypatch
):
    hot, begun = [45.0] * SPEC.n, []  # however quickly the run starts, it can be armed
    warm = Plant.warm
    monkeypatch.setattr(
        Plant, "warm", lambda plant, rise: (warm(plant, rise), begun.append(plant.truth(0.0)))
    )
    for further in ((), ("--draw", "7:1")):
        heat = {"robot": "arm6", "joints": SPEC.joint_names, "unix_s": time.time(), "rise_k": hot}
        (tmp_path / "heat.json").write_text(json.dumps(heat))
        options = ("--policy", arm_policy, "--duration", 0.5, "--speed", "max", "--out", tmp_path, *further)
        assert command(*options)[0] == 0
    rise = [(truth.winding_c - truth.housing_c)[0] for truth in begun]
    assert ((rise[0] > 30) & (rise[0] <= 45)).all()
    np.testing.assert_array_equal(rise[1], 0.0)


def test_default_policy_is_the_output_of_make_export(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, complaint = command()
    assert code == 2
    assert "out/arm.onnx: cannot be read" in complaint


def test_unwritable_output_is_exit_2_and_left_unchanged(command, arm_policy, tmp_path):
    (tmp_path / "out").write_text("mine")
    code, _, complaint = command("--policy", arm_policy, "--out", tmp_path / "out")
    assert code == 2
    assert (
        complaint == f"error: --out {tmp_path / 'out'}: cannot be written: File exists, expected a folder\n"
    )
    assert (tmp_path / "out").read_text() == "mine"


def test_folder_of_another_run_is_exit_2_and_left_unchanged(command, arm_policy, tmp_path):
    (tmp_path / "run.mcap").write_text("of the other run")
    with locked(tmp_path):
        code, _, complaint = command("--policy", arm_policy, "--duration", 1, "--out", tmp_path)
        assert (code, complaint) == (2, f"error: {in_use(tmp_path)}\n")
        assert {path.name for path in tmp_path.iterdir()} == {"run.mcap", LOCK}
    assert (tmp_path / "run.mcap").read_text() == "of the other run"


@pytest.mark.parametrize("name", ["run.mcap", "event-1.mcap", "summary.json", "heat.json"])
def test_a_policy_in_the_place_of_an_output_is_exit_2_and_left_unchanged(command, arm_policy, tmp_path, name):
    policy = shutil.copy(arm_policy, tmp_path / name)
    code, _, complaint = command("--policy", policy, "--duration", 1, "--out", tmp_path)
    expected = f"error: --out {policy}: found a file that is read, expected another place\n"
    assert (code, complaint) == (2, expected)
    assert policy.read_bytes() == arm_policy.read_bytes()


def test_a_draw_in_the_place_of_an_output_is_exit_2_and_left_unchanged(command, arm_policy, tmp_path):
    place, distributions = tmp_path / "summary.json", load_distributions(SPEC)
    before = draw(distributions, SPEC, [robot_seed(7, 0)]).to_json(7, distributions, SPEC)
    place.write_text(before)
    options = ("--policy", arm_policy, "--duration", 1, "--draw", f"{place}:0")
    code, _, complaint = command(*options, "--out", tmp_path)
    assert (code, complaint.startswith(f"error: --out {place}: found a file that is read")) == (2, True)
    assert place.read_text() == before


def test_a_view_without_a_display_is_exit_2(command, arm_policy, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    code, _, complaint = command("--policy", arm_policy, "--out", tmp_path, "--view")
    assert code == 2
    assert "--view: found neither DISPLAY nor WAYLAND_DISPLAY, expected a display" in complaint
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_process_without_torch_prints_lines(arm_policy, tmp_path):
    code = (
        "import sys, deploy.operation.cli, deploy.telemetry.console as console\n"
        "console.WAIT_S = 300\n"
        "try: deploy.operation.cli.cli()\n"
        "finally: sys.exit(99) if 'torch' in sys.modules else None"
    )
    arguments = ["--policy", arm_policy, "--duration", "1", "--speed", "max", "--out", tmp_path]
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    first, *_, last = done.stdout.partition("\nended")[0].splitlines()
    assert "DISARMED" in first
    assert "LATCHED" in last
