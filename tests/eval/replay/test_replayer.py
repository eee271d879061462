import json
import re
from functools import partial

import numpy as np
import pytest
from mcap.reader import make_reader

from support.policies import policy_model

pytest.importorskip("mujoco")

from deploy.start import BAD_INPUT
from deploy.telemetry import recording
from deploy.telemetry.disk_writer import DiskWriter
from eval.faults.schedule import FaultSettings
from eval.replay import bundle
from eval.replay import cli as command
from eval.replay.bundle_files import write_arrays
from eval.replay.capture_window import columns
from eval.replay.replay_text import first_difference, mismatch
from eval.replay.replayer import Replay
from robots.errors import ConfigError, ContractError, RobotError
from support.eval.bundles import ROBOTS_COUNTED, TICKS, first, replayed

pytestmark = pytest.mark.slow


def resealed(folder, **changes):
    """As somebody writes it who means to mislead."""
    about = bundle.BundleInfo.model_validate_json((folder / "bundle.json").read_text())
    bundle.seal(folder, about.model_copy(update=changes))


def test_an_event_is_reproduced_bit_for_bit_in_a_fresh_process(events, tmp_path):
    done = replayed(first(events, "velocity"), "--mcap", tmp_path / "again.mcap")
    assert (done.returncode, done.stderr) == (0, "")
    about = bundle.open_bundle(first(events, "velocity"))
    said = done.stdout
    ticks = about.end - about.begin
    assert f"reproduced: all signals of {ticks} ticks" in said
    assert "differs" not in said
    assert f"robot {about.event.robot} of seed 3: velocity of {about.event.joint}" in said
    rows = [line for line in said.splitlines() if re.match(r"[ !] *[+-]\d+ ", line)]
    assert [row[0] for row in rows if "-1 " in row[:6]] == [" "]
    assert [row[0] for row in rows if "+0 " in row[:6]] == ["!"]
    when, what = re.search(r"(?m)^stop in tick ([+-]\d+): (.+)$", said).groups()
    assert abs(int(when)) < ticks
    assert what
    # Written by another process, from ticks that were lived again: the same file.
    assert (tmp_path / "again.mcap").read_bytes() == (first(events, "velocity") / "window.mcap").read_bytes()


def test_a_policy_of_a_bundle_is_tried_in_a_separate_process_first(events, crashing_trial):
    folder = first(events, "velocity")
    with pytest.raises(ContractError, match=f"^{folder / bundle.POLICY}: {crashing_trial}$"):
        Replay(folder)


def test_every_monitor_that_found_something_left_bundles(events):
    names = {path.name.split("-")[2] for path in events.iterdir()}
    assert {"velocity", "torque", "tool_speed", "tracking"} <= names
    assert {int(path.name[:4]) for path in events.iterdir()} <= set(range(ROBOTS_COUNTED))
    for path in events.iterdir():
        event = bundle.open_bundle(path).event
        assert path.name == bundle.bundle_name(event.robot, event.start, event.monitor)
        assert sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) < 1 << 20


@pytest.mark.parametrize("monitor", ["tool_speed", "velocity"])
def test_load_equals_the_limit_ratio_of_each_tick(lived, monitor):
    """Above the limit from the event's first tick on, as high as the judge said, and what the signals say."""
    replay, again = lived(monitor)
    event, spec = replay.info.event, replay.spec
    assert mismatch(replay, again) == ""
    start = event.start - replay.info.begin
    assert again.load[start] > 1
    assert (again.load[max(0, start - 100) : start] <= 1).all()
    assert again.load[start : start + event.ticks].max() == event.worst
    if monitor == "tool_speed":
        load = np.linalg.norm(again.rows["tool_velocity_true"], axis=1) / spec.workspace.tool_speed_max
    else:
        joint = spec.joint_names.index(event.joint)
        load = np.abs(again.rows["qd_true"][:, joint]) / spec.joints[joint].qd_max
    np.testing.assert_allclose(again.load, load, rtol=1e-12)


def test_window_contains_ticks_before_and_after_the_event(events):
    abouts = [bundle.open_bundle(path) for path in events.iterdir()]
    for about in abouts:
        assert about.event.start - about.begin >= 200 or about.begin == 0
        assert about.end - about.event.start > 200 or about.end == TICKS
        assert about.end - about.begin <= 800
    assert {0} < {about.begin for about in abouts}
    assert len({about.end for about in abouts}) > 1


def topics(path):
    with path.open("rb") as file:
        found = {}
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append(message.log_time)
    return found


def test_the_recording_holds_every_tick_of_every_signal(one):
    about = bundle.open_bundle(one)
    ticks = [round(tick * 5e6) for tick in range(about.begin, about.end)]
    found = topics(one / "window.mcap")
    for topic in ("/measured", "/setpoint", "/state", "/true", "/true_state"):
        assert found[topic] == ticks


def test_a_difference_names_the_first_signal_and_tick(one):
    replay = Replay(one)
    rows = replay.recorded.copy()
    assert first_difference(rows, replay.recorded) is None
    rows["q_sent"][70, 2] = np.nextafter(rows["q_sent"][70, 2], 9)
    rows["q"][71:] += 1.0
    apart = first_difference(rows, replay.recorded)
    assert (apart.tick, apart.signal) == (replay.info.begin + 70, "q_sent")
    rows["reached"][3] += 1
    assert first_difference(rows, replay.recorded)[:2] == (replay.info.begin + 3, "reached")


def changed(folder, name, change):
    """One array of state.npz as somebody likes it."""
    with np.load(folder / "state.npz") as file:
        arrays = dict(file)
    change(arrays)
    write_arrays(folder / name, arrays)
    resealed(folder)


@pytest.fixture
def run(call):
    return partial(call, command.cli)


def test_another_state_is_not_reproduced(one, run):
    def nudge(arrays):
        arrays["robot.plant.rows"][Replay(one).row, 3] += 1e-9

    changed(one, "state.npz", nudge)
    code, said, complaint = run(one)
    assert (code, complaint) == (1, "")
    assert re.search(r"not reproduced: at tick [+-]\d+ of the event, \w+: found .*, recorded", said)


@pytest.mark.parametrize(
    ("name", "value"),
    [("runtime.supervisor.mode", 77), ("robot.plant.tick", 2**63 - 1)],
)
def test_integer_that_no_state_has_is_refused(one, run, name, value):
    changed(one, "state.npz", lambda arrays: arrays[name].fill(value))
    code, _, said = run(one)
    assert code == 2
    assert re.fullmatch(r"error: .*/one/state\.npz: holds an integer that no state has: .*\n", said)


def test_different_final_state_is_reported(one, lived):
    resealed(one, end_digest="0" * 64)
    assert mismatch(Replay(one), lived("velocity")[1]) == "all signals agree, but not the state at the end"


def test_different_event_is_reported(one, lived):
    about, (_, again) = bundle.open_bundle(one), lived("velocity")
    assert mismatch(Replay(one), again) == ""
    resealed(one, event=about.event.model_copy(update={"ticks": about.event.ticks + 1}))
    assert mismatch(Replay(one), again).startswith("the judge found robot=")


def test_replay_environment_may_differ(one):
    resealed(one, identity={"mujoco": "3.9"})
    assert Replay(one).differences["mujoco"] == ("4.0.0", "3.9")


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda a: a.pop("runtime.requested_stop"), "runtime.requested_stop: missing"),
        (lambda a: a.update(x=np.zeros(2)), "x: unknown"),
        (lambda a: a.update({"judge.worst": np.zeros(3)}), r"judge.worst: found float64 \(3,\), expected"),
        (lambda a: a.update({"runtime.ticks": np.array(5)}), r"runtime.ticks: found 5, expected"),
    ],
)
def test_mismatched_state_is_refused_by_name(one, run, change, complaint):
    changed(one, "state.npz", change)
    code, _, said = run(one)
    assert code == 2
    assert re.fullmatch(rf"error: .*/one/state\.npz: {complaint}.*\n", said)


@pytest.mark.parametrize("name", ["runtime.smoother.q", "robot.plant.housings.celsius"])
def test_numbers_of_a_state_that_are_not_finite_are_replayed(one, run, name):
    """Even where numpy's warnings are errors, as they are here."""
    changed(one, "state.npz", lambda arrays: arrays[name].fill(np.inf))
    _, said, complaint = run(one)
    assert complaint == ""
    assert re.search("(?m)^(not )?reproduced: ", said)


def test_state_of_other_code_is_reported_as_such(one, run):
    changed(one, "state.npz", lambda arrays: arrays.pop("runtime.requested_stop"))
    resealed(one, identity={"code_digest": "ab" * 32})
    code, _, said = run(one)
    assert code == 2
    assert re.search(
        r"runtime\.requested_stop: missing; code_digest: found \w{12} here, abababababab in the bundle: replay",
        said,
    )


def test_a_recording_that_cannot_be_written_is_named_as_it_was_given(one, run, tmp_path, monkeypatch):
    code, _, said = run(one, "--mcap", tmp_path)
    expected = "found a folder or a device, expected a file or nothing"
    assert (code, said) == (BAD_INPUT, f"error: --mcap {tmp_path}: {expected}\n")
    place = tmp_path / "again.mcap"
    monkeypatch.setattr(recording, "DiskWriter", lambda _: DiskWriter(tmp_path / "nowhere" / "again.mcap"))
    code, _, said = run(one, "--mcap", place)
    assert (code, said) == (
        BAD_INPUT,
        f"error: --mcap {place}: cannot be written: No such file or directory\n",
    )
    assert not place.exists()


@pytest.mark.parametrize(("option", "name"), [("--mcap", "again.mcap"), ("--video", "again.gif")])
def test_the_place_of_an_output_is_checked_before_the_simulation(
    one, run, tmp_path, monkeypatch, option, name
):
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr(Replay, "run", lambda *_: pytest.fail("simulated"))
    place = tmp_path / "file" / name
    code, said, complaint = run(one, option, place)
    assert (code, said) == (BAD_INPUT, "")
    assert complaint == f"error: {option} {place}: cannot be written: Not a directory\n"


def test_another_policy_is_refused_by_name(one, run):
    model = policy_model()
    model.doc_string = "another one"
    (one / "policy.onnx").write_bytes(model.SerializeToString())
    code, said, complaint = run(one)
    assert (code, said) == (2, "")
    assert re.fullmatch(r"error: .*/one/policy\.onnx: SHA-256: found .*: damaged\n", complaint)
    resealed(one)  # by somebody who says that it belongs there: it is the same, but for its digest
    code, said, _ = run(one)
    assert code == 0
    assert re.search(r"differs: policy_digest: \w{40} here, \w{40} in the bundle", said)


@pytest.mark.parametrize(
    ("event", "complaint"),
    [({"robot": 3}, "event.robot: found 3, expected one of"), ({"joint": None}, "event.joint: found None")],
)
def test_impossible_event_is_refused(one, event, complaint):
    about = bundle.open_bundle(one)
    resealed(one, event=about.event.model_copy(update=event))
    with pytest.raises(ConfigError, match=rf"bundle\.json: {complaint}"):
        Replay(one)


FAULTS = FaultSettings(coverage=0.95, cycle_s=18.0, operator_s=5.0)


@pytest.mark.parametrize(
    ("job", "end", "complaint"),
    [
        ({"ticks": 1 << 53}, None, r"job\.ticks: found 9007199254740992, expected at most 7200000000"),
        (
            {"ticks": 1 << 40, "faults": FAULTS},
            None,
            r"job\.ticks: found 1099511627776, expected at most 36000600",
        ),
        ({"robots": 17}, None, r"job\.robots: found 17, expected at most 16"),
        ({"ticks": 1 << 32}, 1 << 31, r"end: found 2147483648, expected at most \d{3,4}"),
    ],
)
def test_excessive_length_is_refused(one, job, end, complaint):
    about = bundle.open_bundle(one)
    resealed(one, job=about.job.model_copy(update=job), end=end or about.end)
    with pytest.raises(ConfigError, match=rf"bundle\.json: {complaint}$"):
        Replay(one)


@pytest.mark.parametrize(
    ("job", "complaint"),
    [
        (
            {"faults": FAULTS.model_copy(update={"classes": ("bus silence",)})},
            r"job\.faults\.classes: found 'bus silence', expected some of: encoder off, ",
        ),
        (
            {"faults": FAULTS.model_copy(update={"cycle_s": 1e308})},
            r"job\.faults\.cycle_s: .* less than or equal to 36000000, found 1e\+308",
        ),
        ({"operator_s": 1e308}, r"job\.operator_s: .* less than or equal to 36000000, found 1e\+308"),
    ],
)
def test_impossible_settings_of_the_job_are_refused(one, job, complaint):
    about = bundle.open_bundle(one)
    resealed(one, job=about.job.model_copy(update=job))
    with pytest.raises(ConfigError, match=rf"bundle\.json: {complaint}"):
        Replay(one)


def test_different_draw_is_refused(one):
    draws = json.loads((one / "draws.json").read_text())
    (one / "draws.json").write_text(json.dumps(draws | {"seed": 4}))
    resealed(one)
    with pytest.raises(ConfigError, match=r"draws\.json: seed: found 4, expected 3"):
        Replay(one)


def test_no_bundle_is_bad_input(tmp_path, run):
    code, said, complaint = run(tmp_path / "none")
    assert (code, said) == (2, "")
    assert re.search(r"none/bundle\.json: missing, expected the folder of a bundle", complaint)
    assert run(tmp_path / "none", "--video", tmp_path / "a.avi")[2].endswith(
        "found .avi, expected .gif or .mp4\n"
    )


def test_no_display_is_bad_input(one, run, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    code, _, complaint = run(one, "--view")
    assert code == 2
    assert "--view: found neither DISPLAY" in complaint


def test_a_bundle_of_a_model_that_does_not_compile_within_bounds_is_not_opened(one, monkeypatch):
    def refused(model, folder):
        raise RobotError(f"{model}: too dear")

    monkeypatch.setattr("eval.replay.replayer.check_compiles", refused)
    with pytest.raises(RobotError, match=r"model\.xml: too dear"):
        Replay(one)


def test_signals_round_trip_through_columns(one):
    rows = Replay(one).recorded
    arrays = columns(rows)
    assert all(array.flags.c_contiguous for array in arrays.values())
    np.testing.assert_array_equal(arrays["tick"], rows["tick"])
