import errno
import io
import json
import os
import resource
import shutil
import sys
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

from deploy.motion.takeover import DAMPING_SHARE, TAKEOVER_S
from deploy.reasons import Reason, describe
from deploy.state import Mode
from deploy.telemetry import disk_writer, signals
from deploy.telemetry.output_files import check_folder
from deploy.telemetry.recorder import AFTER_S, EVENTS_MAX, Recorder
from deploy.telemetry.signals import RING_S, Ring, row_type
from robots.errors import OutputError
from robots.motors.drive_gains import drive_gains
from robots.spec import load_robot
from support.modes import mode_contract
from support.runtimes import built, every, heard

SPEC = load_robot("arm6")
START_NS = 1_700_000_000_000_000_000
TICK_NS = 5_000_000
DEPTH, AFTER = round(RING_S / SPEC.dt), round(AFTER_S / SPEC.dt)
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/full")


class Scripted:
    """What a recorder sees of a runtime; every number is a function of the tick, the robot and the joint."""

    def __init__(self, robots=1):
        self.spec, self.robot, self.ticks = SPEC, SimpleNamespace(robots=robots), 0
        self.task = SimpleNamespace(size=3, criterion=SimpleNamespace(tolerance=0.02))
        self.supervisor = SimpleNamespace(
            mode=np.full(robots, Mode.RUNNING, np.int8), reason=np.zeros(robots, np.int64)
        )

    def numbers(self, tick, part, width=SPEC.n):
        robot, joint = np.arange(self.robot.robots)[:, None], np.arange(width)
        return tick + 1000.0 * robot + joint / 8 + part / 128

    def tick(self):
        joints = [self.numbers(self.ticks, part) for part in (*range(8), 10, 11, 12)]
        q, qd, housing_c, winding_c = (*joints[:3], joints[8])
        self.state = SimpleNamespace(q=q, qd=qd, housing_c=housing_c, winding_c=winding_c, base=None)
        self.action = SimpleNamespace(value=joints[3])
        self.setpoint = SimpleNamespace(q=joints[4], qd=joints[5], qdd=joints[6])
        drive = SimpleNamespace(kp=joints[9], kd=joints[10])
        self.command = SimpleNamespace(tau=joints[7], drive=drive)
        self.task.achieved, self.task.goal = (self.numbers(self.ticks, part, 3) for part in (8, 9))
        self.task.goal_position, self.tool = self.task.goal, SimpleNamespace(position=self.task.achieved)
        self.task.reached = np.full(self.robot.robots, self.ticks // 800)
        self.task.attempted = np.full(self.robot.robots, self.ticks // 400)
        self.ticks += 1


def recorder(folder, runtime=None, start_ns=START_NS):
    return Recorder(folder, runtime or Scripted(), start_ns=start_ns, about={"policy": "x.onnx"})


def record(folder, ticks, *, stops=None, start_ns=START_NS):
    """Record `ticks` ticks; `stops` maps a tick to the reason for which the robot starts to stop."""
    runtime = Scripted()
    writer = recorder(folder, runtime, start_ns)
    for tick in range(ticks):
        reason = (stops or {}).get(tick, 0)
        runtime.supervisor.mode[0] = Mode.STOPPING if reason else Mode.RUNNING
        runtime.supervisor.reason[0] = reason
        runtime.tick()
        writer.step(runtime, f"{describe(reason)} (elbow)" if reason else "")
    writer.close()
    return writer


def messages(path):
    """Everything in a file by topic: (log time, schema name, decoded)."""
    pool, found = descriptor_pool.DescriptorPool(), {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            data = decoded(pool, schema, message.data)
            found.setdefault(channel.topic, []).append((message.log_time, schema.name, data))
    return found


def decoded(pool, schema, data):
    if schema.encoding == "jsonschema":
        return json.loads(data)
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.AddSerializedFile(file.SerializeToString())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString(data)


def test_the_stream_is_thinned_to_50_hz(tmp_path):
    assert record(tmp_path, 401).events == ()
    found = messages(tmp_path / "run.mcap")
    names = {topic: {name for _, name, _ in items} for topic, items in found.items()}
    assert names == {
        "/measured": {"foxglove.JointStates"},
        "/setpoint": {"foxglove.JointStates"},
        "/scene": {"foxglove.SceneUpdate"},
        "/log": {"foxglove.Log"},
        "/state": {"firstshift.State"},
    }
    for topic in ("/measured", "/setpoint", "/scene", "/state"):
        times = [time for time, _, _ in found[topic]]
        assert times == [START_NS + tick * TICK_NS for tick in range(0, 401, 4)]


@pytest.mark.parametrize(("start_s", "shown_s"), [(2**32 - 1, 2**32 - 1), (10**11, 2**32 - 1), (-9, 0)])
def test_a_clock_that_is_wrong_stops_no_recording(tmp_path, start_s, shown_s):
    """The last second of timestamps begins before the robot ticks, and ends while it does."""
    record(tmp_path, 241, stops={100: Reason.STUCK}, start_ns=start_s * 10**9)
    assert {
        measured.timestamp.seconds for _, _, measured in messages(tmp_path / "run.mcap")["/measured"]
    } == {shown_s}


def test_logged_numbers_match_their_tick(tmp_path):
    record(tmp_path, 41)
    found, script = messages(tmp_path / "run.mcap"), Scripted()
    for k, (time, _, measured) in enumerate(found["/measured"]):
        tick = 4 * k
        assert measured.timestamp.seconds * 10**9 + measured.timestamp.nanos == time
        assert [joint.name for joint in measured.joints] == list(SPEC.joint_names)
        assert [joint.position for joint in measured.joints] == script.numbers(tick, 0)[0].tolist()
        assert [joint.velocity for joint in measured.joints] == script.numbers(tick, 1)[0].tolist()
        setpoint = found["/setpoint"][k][2].joints
        for part, field in enumerate(("position", "velocity", "acceleration", "effort"), start=4):
            assert [getattr(joint, field) for joint in setpoint] == script.numbers(tick, part)[0].tolist()
        spheres = {entity.id: entity.spheres[0] for entity in found["/scene"][k][2].entities}
        for part, name in ((8, "tool"), (9, "goal")):
            at, expected = spheres[name].pose.position, script.numbers(tick, part, 3)[0].tolist()
            assert [at.x, at.y, at.z] == expected
            assert found["/state"][k][2][name] == expected
        assert spheres["goal"].size.x == 0.04
        assert found["/state"][k][2]["housing_c"] == script.numbers(tick, 2)[0].tolist()
        assert found["/state"][k][2]["winding_c"] == script.numbers(tick, 10)[0].tolist()
        assert found["/state"][k][2]["stiffness"] == script.numbers(tick, 11)[0].tolist()
        assert found["/state"][k][2]["damping"] == script.numbers(tick, 12)[0].tolist()
        assert found["/state"][k][2]["target"] == script.numbers(tick, 3)[0].tolist()


def test_the_file_of_an_event_shows_how_drives_take_over(tmp_path):
    runtime = built(1, contract=mode_contract("torque"))
    heard(runtime)
    assert not runtime.arm(every(runtime)).any()
    writer = recorder(tmp_path, runtime)
    ticks = round(TAKEOVER_S / SPEC.dt)
    for tick in range(70 + ticks):
        if tick == 50:
            runtime.stop(Reason.OVERRUN)
        runtime.act(None if runtime.sense() is None else np.zeros((1, SPEC.n)))
        writer.step(runtime, "")
    writer.close()
    states = [state for _, _, state in messages(writer.events[0])["/state"]]
    begin = next(k for k, state in enumerate(states) if state["mode"] == "STOPPING")
    stiffness, damping = (np.array([state[name] for state in states]) for name in ("stiffness", "damping"))
    own = drive_gains(SPEC)
    assert not stiffness[begin - 1].any()
    assert not damping[begin - 1].any()
    np.testing.assert_allclose(stiffness[begin], 0.01 * own.kp)
    np.testing.assert_allclose(damping[begin, :2], DAMPING_SHARE * own.kd[:2])
    assert (damping[begin, 2:] < DAMPING_SHARE * own.kd[2:]).all()
    assert (np.diff(stiffness[begin : begin + ticks], axis=0) > 0).all()
    np.testing.assert_allclose(stiffness[begin + ticks :].max(axis=0), own.kp)


def test_mode_changes_are_logged_with_their_reasons(tmp_path):
    both = Reason.HEAT | Reason.TRACKING
    record(tmp_path, 20, stops={11: both, 12: both})
    found = messages(tmp_path / "run.mcap")
    said = [((time - START_NS) // TICK_NS, log.message) for time, _, log in found["/log"]]
    why = "a motor is too hot, or its temperature is unknown; a joint does not follow its setpoint"
    assert said == [
        (0, "DISARMED → RUNNING"),
        (11, f"RUNNING → STOPPING: {why} (elbow)"),
        (13, "STOPPING → RUNNING"),
    ]
    state = found["/state"][3][2]  # tick 12
    assert (state["mode"], state["reason"]) == ("STOPPING", why)


def test_metadata_identify_the_run(tmp_path):
    record(tmp_path, 1)
    with (tmp_path / "run.mcap").open("rb") as file:
        (found,) = make_reader(file).iter_metadata()
    assert (found.name, found.metadata) == ("run", {"policy": "x.onnx"})


def ticks(path):
    return [(time - START_NS) / TICK_NS for time, _, _ in messages(path)["/measured"]]


def test_an_event_keeps_every_tick_around_it(tmp_path):
    writer = record(tmp_path, 1000, stops={500: Reason.COLLISION})
    assert writer.events == (tmp_path / "event-500.mcap",)
    last = 500 + AFTER
    found, script = messages(writer.events[0]), Scripted()
    assert ticks(writer.events[0]) == list(range(last - DEPTH + 1, last + 1))
    for time, _, measured in found["/measured"]:
        tick = (time - START_NS) // TICK_NS
        assert [joint.position for joint in measured.joints] == script.numbers(tick, 0)[0].tolist()
    modes = [state["mode"] for _, _, state in found["/state"]]
    assert modes.index("STOPPING") == 500 - (last - DEPTH + 1)
    assert modes.count("STOPPING") == 1


@pytest.mark.parametrize(("stop", "end"), [(500, 510), (3, 8), (0, 1), (500, 500 + AFTER + 3)])
def test_event_at_the_end_is_written_as_far_as_recorded(tmp_path, stop, end):
    writer = record(tmp_path, end, stops={stop: Reason.COLLISION})
    newest = min(end - 1, stop + AFTER)
    assert ticks(writer.events[0]) == list(range(max(0, newest - DEPTH + 1), newest + 1))


def test_first_and_last_of_quick_stops_are_events(tmp_path):
    writer = record(tmp_path, 900, stops=dict.fromkeys((500, 510, 560, 590), Reason.STALE))
    assert [path.name for path in writer.events] == ["event-500.mcap", "event-590.mcap"]


@pytest.mark.parametrize("second", [520, 599, 600, 601, 605, 699, 700, 701])
def test_a_stop_soon_after_another_is_an_event_of_its_own(tmp_path, second):
    writer = record(tmp_path, 900, stops={500: Reason.STALE, second: Reason.STALE})
    assert [path.name for path in writer.events] == ["event-500.mcap", f"event-{second}.mcap"]
    for path, last in zip(writer.events, (600, second + AFTER), strict=True):
        times = [time for time, _, _ in messages(path)["/state"]]
        assert times == [START_NS + tick * TICK_NS for tick in range(last - DEPTH + 1, last + 1)]


@pytest.mark.slow
def test_the_number_of_events_is_bounded(tmp_path):
    stops = dict.fromkeys(range(0, 10_000, 250), Reason.STALE)
    writer = record(tmp_path, 10_000, stops=stops)
    assert len(writer.events) == EVENTS_MAX < len(stops)
    assert sorted(tmp_path.glob("event-*.mcap")) == sorted(writer.events)


def test_operator_stop_is_an_event_only_on_request(tmp_path):
    runtime = Scripted()
    writer = recorder(tmp_path, runtime)
    runtime.supervisor.mode[0], runtime.supervisor.reason[0] = Mode.STOPPING, Reason.OPERATOR
    for _ in range(AFTER + 2):
        runtime.tick()
        writer.step(runtime, describe(int(Reason.OPERATOR)))
    assert writer.events == ()
    writer.event()
    writer.close()
    assert [path.name for path in writer.events] == [f"event-{AFTER + 1}.mcap"]


@pytest.mark.parametrize("robots", [1, 3])
def test_the_ring_holds_the_last_ticks_of_every_robot(robots):
    runtime = Scripted(robots)
    ring = Ring(SPEC, robots, row_type(SPEC, 3))
    assert ring.last().shape == (0, robots)
    for count in range(1, 3 * DEPTH):
        runtime.tick()
        row = ring.step(runtime)
        if count in (1, 7, DEPTH, DEPTH + 1, 3 * DEPTH - 1):
            rows = ring.last()
            assert rows.shape == (min(count, DEPTH), robots)
            np.testing.assert_array_equal(rows["tick"][:, 0], np.arange(max(0, count - DEPTH), count))
            for k in (0, -1):
                np.testing.assert_array_equal(rows["q"][k], runtime.numbers(rows["tick"][k, 0], 0))
                np.testing.assert_array_equal(rows["goal"][k], runtime.numbers(rows["tick"][k, 0], 9, 3))
            np.testing.assert_array_equal(row, rows[-1])


def test_only_files_of_a_former_run_are_replaced(tmp_path):
    record(tmp_path, 700, stops={10: Reason.STALE, 400: Reason.STALE})
    mine = {"notes.txt", "event-birthday.mcap", "event-.mcap", "event-\u0663.mcap"}
    for name in mine:
        (tmp_path / name).write_text("mine")
    writer = record(tmp_path, 700, stops={20: Reason.STALE})
    assert {path.name for path in tmp_path.iterdir()} == {"run.mcap", "event-20.mcap", *mine}
    assert len(messages(writer.path)["/measured"]) == 175


# ---- disks that fail ----


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "out").write_text("mine")
    for folder in (tmp_path / "out", tmp_path / "out" / "deeper"):
        with pytest.raises(OutputError, match=f"--out {folder}: cannot be written: .+, expected a folder"):
            check_folder(folder)
    assert (tmp_path / "out").read_text() == "mine"


@pytest.mark.parametrize("target", ["nothing", "out"])
def test_a_folder_that_is_a_link_to_none_is_refused(tmp_path, target):
    (tmp_path / "out").symlink_to(target)
    message = f"--out {tmp_path / 'out'}: cannot be written: found a link to no folder, expected a folder"
    with pytest.raises(OutputError, match=message):
        check_folder(tmp_path / "out")


def test_valid_folder_is_left_unchanged(tmp_path):
    check_folder(tmp_path / "a" / "b")
    assert list((tmp_path / "a" / "b").iterdir()) == []


@pytest.mark.parametrize("name", ["run.mcap", "event-7.mcap", "summary.json"])
def test_a_folder_in_the_place_of_a_former_file_is_refused_and_the_others_remain(tmp_path, name):
    names = {"run.mcap", "event-7.mcap", "event-9.mcap", "summary.json"}
    for each in names - {name}:
        (tmp_path / each).write_text("former")
    (tmp_path / name).mkdir()
    with pytest.raises(OutputError, match=f"--out {tmp_path / name}: found a folder, expected a file or"):
        recorder(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == names


def test_a_link_or_a_pipe_in_the_place_of_the_recording_is_replaced(tmp_path):
    """A link's file stays as it is, and nobody reads the pipe."""
    (tmp_path / "mine").write_text("mine")
    for make in (lambda place: place.symlink_to("mine"), os.mkfifo):
        (tmp_path / "run.mcap").unlink(missing_ok=True)
        make(tmp_path / "run.mcap")
        assert messages(record(tmp_path, 10).path)
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_disk_that_hangs_is_an_error_before_any_motion(tmp_path, monkeypatch):
    late = Event()

    def hangs(*_):
        late.wait()
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(disk_writer, "WAIT_S", 0.01)
    monkeypatch.setattr(disk_writer.Path, "open", hangs)
    try:
        with pytest.raises(
            OutputError, match=r"run.mcap: cannot be written: the disk took longer than 0.01 s"
        ):
            recorder(tmp_path)
    finally:
        late.set()


@linux_only
def test_full_disk_is_an_error_before_any_motion(tmp_path, monkeypatch):
    monkeypatch.setattr(disk_writer.Path, "open", lambda *_: io.FileIO("/dev/full", "w"))
    with pytest.raises(OutputError, match=r"run.mcap: cannot be written: No space left on device"):
        recorder(tmp_path)


LOSSES = {
    "deleted": lambda path: path.unlink(),
    "moved": lambda path: path.rename(path.with_name("mine")),
    "replaced": lambda path: (path.unlink(), path.write_text("mine")),
    "folder deleted": lambda path: shutil.rmtree(path.parent),
    "folder moved": lambda path: path.parent.rename(path.parent.with_name("mine")),
}


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize(("name", "what"), [("run.mcap", "recording"), ("event-10.mcap", "event")])
def test_a_file_that_is_no_longer_at_its_place_is_lost(tmp_path, loss, name, what):
    """Be it still written, or complete as that of the event is."""
    runtime, path = Scripted(), tmp_path / "out" / name
    path.parent.mkdir()
    writer = recorder(path.parent, runtime)
    for tick in range(400):
        runtime.supervisor.mode[0] = Mode.STOPPING if tick == 10 else Mode.RUNNING
        runtime.supervisor.reason[0] = Reason.STALE if tick == 10 else 0
        runtime.tick()
        writer.step(runtime, "")
        if tick == 300:
            writer._events[0].wait()
            LOSSES[loss](path)
    writer.close()
    lost = f"{what} {path}: cannot be written: it was deleted, moved or replaced"
    assert lost in writer.lost
    assert len(writer.lost) == (2 if "folder" in loss else 1)


def test_a_folder_that_was_moved_and_is_now_a_link_keeps_its_files(tmp_path):
    runtime, out = Scripted(), tmp_path / "out"
    out.mkdir()
    writer = recorder(out, runtime)
    out.rename(tmp_path / "elsewhere")
    out.symlink_to("elsewhere")
    writer.close()
    assert writer.lost == []


@pytest.fixture
def small_disk():
    """No file may grow beyond 100 kB."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_events_are_kept_after_the_stream_is_lost(tmp_path):
    """Each file that fails is named once; here the first two."""
    runtime, stops = Scripted(), (100, 300)
    writer = recorder(tmp_path, runtime)
    (tmp_path / "event-100.mcap").mkdir()
    writer._stream._disk.error = OSError(28, "No space left on device")
    for tick in range(600):
        runtime.supervisor.mode[0] = Mode.STOPPING if tick in stops else Mode.RUNNING
        runtime.supervisor.reason[0] = Reason.STALE if tick in stops else 0
        runtime.tick()
        writer.step(runtime, "")
    writer.close()
    assert writer.lost == [
        f"recording {tmp_path / 'run.mcap'}: cannot be written: No space left on device",
        f"event {tmp_path / 'event-100.mcap'}: cannot be written: Is a directory",
    ]
    assert ticks(tmp_path / "event-300.mcap")[-1] == 300 + AFTER


@pytest.mark.usefixtures("small_disk")
@pytest.mark.slow
def test_disk_that_fills_up_during_a_run_is_reported_once_and_stops_no_tick(tmp_path, caplog, capfd):
    writer = record(tmp_path, 8000)
    assert writer.lost == [f"recording {tmp_path / 'run.mcap'}: cannot be written: File too large"]
    assert (caplog.text, *capfd.readouterr()) == ("", "", "")


def test_another_signal_is_one_row(monkeypatch):
    age = signals.Signal(name="age", size=1, read=lambda runtime: runtime.state.age[:, None], in_state=True)
    monkeypatch.setattr(signals, "SIGNALS", (*signals.SIGNALS, age))
    runtime = built()
    ring = signals.Ring(SPEC, runtime.robot.robots, signals.row_type(SPEC, runtime.task.size))
    runtime.tick()
    np.testing.assert_array_equal(ring.step(runtime)["age"][:, 0], runtime.state.age)
    assert "age" in signals.state_schema()["properties"]
