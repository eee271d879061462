import json
import os
import shutil
import zipfile
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from eval.judge.counts import Event
from eval.judge.monitors import MONITORS, NAMES
from eval.replay import bundle
from eval.replay.bundle import FILES, BundleInfo, EventRecord, JobRecord
from eval.replay.bundle_files import (
    copy_bundles,
    delete_bundles,
    list_bundles,
    new_bundle,
    read_arrays,
    remove_bundles,
    state_digest,
    write_arrays,
)
from eval.replay.event_capture import HARD_BUNDLES, SOFT_BUNDLES, select_events
from robots.errors import ConfigError, OutputError
from robots.spec import load_robot
from support.robots.model_files import two_links

ARRAYS = {
    "a.ticks": np.array(7),
    "b": np.arange(12, dtype=np.float64).reshape(3, 4) / 7,
    "c": np.array([True, False]),
    "nothing": np.array([np.nan, -np.inf]),
}
LIKE = {name: np.zeros_like(array) for name, array in ARRAYS.items()}
EVENT = EventRecord(robot=9, monitor="torque", joint="elbow", start=420, ticks=3, worst=1.01)


def about(**changes):
    job = JobRecord(seed=3, first=8, robots=2, ticks=1000, sample_ticks=10, faults=None)
    how = {
        "identity": {},
        "job": job,
        "event": EVENT,
        "begin": 200,
        "end": 800,
        "end_digest": "",
        "files": {},
    }
    return BundleInfo(**(how | changes))


def filled(place, **changes):
    """A bundle with something of every name in it."""
    with new_bundle(place) as folder:
        for name in FILES:
            (folder / name).write_bytes(name.encode() * 3)
        bundle.seal(folder, about(**changes))
    return place


def test_arrays_round_trip_bit_for_bit(tmp_path):
    for name in "ab":
        write_arrays(tmp_path / name, ARRAYS)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    found = read_arrays(tmp_path / "a", LIKE)
    assert list(found) == list(LIKE)
    for name, array in ARRAYS.items():
        assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)
        assert found[name].tobytes() == array.tobytes()
    with np.load(tmp_path / "a") as file:
        np.testing.assert_array_equal(file["b"], ARRAYS["b"])


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"b": None}, "b: missing"),
        ({"d": np.zeros(2)}, "d: unknown"),
        ({"b": np.zeros((4, 3))}, r"b: found float64 \(4, 3\), expected float64 \(3, 4\)"),
        ({"b": np.zeros((3, 4), np.float32)}, r"b: found float32 \(3, 4\), expected float64"),
        ({"b": np.zeros((3, 4), order="F")}, r"b: found float64 \(3, 4\), expected float64"),
        ({"a.ticks": np.array([7])}, r"a.ticks: found int64 \(1,\), expected int64 \(\)"),
    ],
)
def test_arrays_of_another_kind_are_refused_by_name(tmp_path, change, complaint):
    arrays = {name: array for name, array in (ARRAYS | change).items() if array is not None}
    write_arrays(tmp_path / "state.npz", arrays)
    with pytest.raises(ConfigError, match=rf"state\.npz: {complaint}"):
        read_arrays(tmp_path / "state.npz", LIKE)


def crafted(path, header, data=b"\0" * 96):
    """An npz whose array `b` begins with a header of somebody's own."""
    text = header.ljust(117).encode() + b"\n"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("b.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data)


@pytest.mark.parametrize(
    ("header", "data"),
    [
        ("{'descr': '|O', 'fortran_order': False, 'shape': (3, 4)}", b"\0" * 96),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}", b"\0" * 96),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4)}", b"\0" * 95),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4)}", b"\0" * 97),
        ("__import__('os').abort()", b""),
        ("{'descr': ('<f8',", b""),
        ("{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4)}" + 20_000 * " ", b"\0" * 96),
    ],
)
def test_reading_neither_unpickles_nor_exceeds_the_expected_size(tmp_path, header, data):
    crafted(tmp_path / "state.npz", header, data)
    with pytest.raises(ConfigError, match=r"state\.npz: [^\n]*$"):
        read_arrays(tmp_path / "state.npz", {"b": np.zeros((3, 4))})


def test_damaged_file_is_refused(tmp_path):
    path = tmp_path / "state.npz"
    write_arrays(path, {"b": np.random.default_rng(0).normal(size=500)})
    data = path.read_bytes()
    for spoilt in (data[:-30], b"", data[:1000] + bytes([data[1000] ^ 1]) + data[1001:]):
        path.write_bytes(spoilt)
        with pytest.raises(ConfigError, match=r"state\.npz: cannot be read"):
            read_arrays(path, {"b": np.zeros(500)})


def test_arrays_of_a_compression_without_a_bound_are_refused(tmp_path):
    path = tmp_path / "state.npz"
    write_arrays(path, {"b": np.zeros(500)})
    with zipfile.ZipFile(path) as file:
        data = file.read("b.npy")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_BZIP2) as file:
        file.writestr("b.npy", data)
    with pytest.raises(ConfigError, match=r"state\.npz: b\.npy: found compression 12, expected none or 8$"):
        read_arrays(path, {"b": np.zeros(500)})


def test_sealed_bundle_opens_unchanged(tmp_path):
    found = bundle.open_bundle(filled(tmp_path / "events" / "x"))
    assert found.model_copy(update={"files": {}, "digest": ""}) == about()
    assert set(found.files) == set(FILES)
    assert [file.name for file in (tmp_path / "events").iterdir()] == ["x"]


@pytest.mark.parametrize("name", FILES)
def test_a_flipped_bit_in_any_file_and_a_missing_file_are_refused_by_name(tmp_path, name):
    path = filled(tmp_path / "x") / name
    data = path.read_bytes()
    path.write_bytes(data[:5] + bytes([data[5] ^ 1]) + data[6:])
    with pytest.raises(ConfigError, match=rf"x/{name}: SHA-256: found \w{{12}}, expected \w{{12}}: damaged"):
        bundle.open_bundle(tmp_path / "x")
    path.unlink()
    with pytest.raises(ConfigError, match=rf"x/{name}: cannot be read: No such file"):
        bundle.open_bundle(tmp_path / "x")


def test_a_folder_that_is_no_bundle_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"bundle\.json: missing, expected the folder of a bundle"):
        bundle.open_bundle(tmp_path)


def test_the_robot_s_model_and_its_meshes_are_in_a_bundle(tmp_path):
    """Wherever they lie in the robot's folder; a changed one is refused as any other file."""
    spec = load_robot(two_links(tmp_path))
    names = {*bundle.robot_files(spec)}
    assert names == {"robot.toml", "draws.toml", "limits.toml", "two.urdf", "meshes/fore.stl"}
    with new_bundle(tmp_path / "x") as folder:
        for name in (*FILES, *(f"robot/{name}" for name in names)):
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(b"mesh")
        bundle.seal(folder, about())
    assert {*bundle.open_bundle(tmp_path / "x").files} == {*FILES, "robot/two.urdf", "robot/meshes/fore.stl"}
    (tmp_path / "x" / "robot" / "meshes" / "fore.stl").write_bytes(b"mush")
    with pytest.raises(ConfigError, match=r"robot/meshes/fore\.stl: SHA-256: found"):
        bundle.open_bundle(tmp_path / "x")


@pytest.mark.parametrize(
    "name", ["notes.txt", "robot/../../x", "/robot/x", "robots/x", "robot//model.xml", "robot/./x"]
)
def test_bundle_reads_nothing_outside_its_folder(tmp_path, name):
    folder = filled(tmp_path / "x")
    listed = bundle.open_bundle(folder)
    listed = listed.model_copy(update={"files": listed.files | {name: "0" * 64}})
    sealed = listed.model_copy(update={"digest": listed.sealed()})
    (folder / "bundle.json").write_text(sealed.model_dump_json())
    with pytest.raises(ConfigError, match=rf"bundle\.json: files: {name}: unknown"):
        bundle.open_bundle(folder)


def test_a_bundle_of_many_links_to_one_file_is_not_read(tmp_path, monkeypatch):
    folder = filled(tmp_path / "x")
    monkeypatch.setattr(bundle, "BYTES_MAX", sum(path.stat().st_size for path in folder.rglob("*")) + 1000)
    bundle.open_bundle(folder)
    (folder / "robot" / "mesh.stl").write_bytes(bytes(600))
    names = [f"robot/{number}.stl" for number in range(20)]
    for name in names:
        os.link(folder / "robot" / "mesh.stl", folder / name)
    listed = bundle.open_bundle(folder)
    listed = listed.model_copy(update={"files": listed.files | dict.fromkeys(names, "0" * 64)})
    sealed = listed.model_copy(update={"digest": listed.sealed()})
    (folder / "bundle.json").write_text(sealed.model_dump_json())
    with pytest.raises(ConfigError, match=r"bundle\.json: files: found \d+ bytes, expected at most \d+$"):
        bundle.open_bundle(folder)


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        (("event", "start"), 421, "digest: found"),
        (("end_digest",), "1" * 64, "digest: found"),
        (("event", "monitor"), "luck", "event.monitor: .*expected one of position_requested"),
        (("begin",), -1, "begin: .*found -1"),
        (("surprise",), 1, "surprise: "),
        (("version",), 2, "version: "),
    ],
)
def test_a_changed_description_is_refused_by_field(tmp_path, field, value, complaint):
    path = filled(tmp_path / "x") / "bundle.json"
    data = json.loads(path.read_text())
    place = data
    for key in field[:-1]:
        place = place[key]
    place[field[-1]] = value
    path.write_text(json.dumps(data))
    with pytest.raises(ConfigError, match=rf"bundle\.json: {complaint}"):
        bundle.open_bundle(tmp_path / "x")


@pytest.mark.parametrize("spoilt", [b"", b"{", b"\xff\xfe", b"[" * 60_000, b" " * 70_000])
def test_malformed_description_is_refused(tmp_path, spoilt):
    (filled(tmp_path / "x") / "bundle.json").write_bytes(spoilt)
    with pytest.raises(ConfigError, match=r"bundle\.json: "):
        bundle.open_bundle(tmp_path / "x")


@pytest.mark.parametrize("changes", [{"begin": 421}, {"end": 420}, {"end": 1001}])
def test_window_contains_its_event_and_stays_in_the_soak(tmp_path, changes):
    with pytest.raises(
        ConfigError, match=r"begin .* event\.start 420, end .*: .*|expected them in this order"
    ):
        bundle.open_bundle(filled(tmp_path / "x", **changes))


def test_an_older_bundle_of_the_same_name_is_replaced(tmp_path):
    filled(tmp_path / "x", begin=100)
    (tmp_path / "x" / "notes.txt").write_text("mine")
    assert bundle.open_bundle(filled(tmp_path / "x")).begin == 200
    assert not (tmp_path / "x" / "notes.txt").exists()


def test_disk_failure_leaves_old_files(tmp_path, monkeypatch):
    filled(tmp_path / "x", begin=100)

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(bundle, "seal", full)
    with pytest.raises(OutputError, match="x: cannot be written: No space left on device"):
        filled(tmp_path / "x")
    assert bundle.open_bundle(tmp_path / "x").begin == 100
    assert os.listdir(tmp_path) == ["x"]


@pytest.mark.parametrize("finished", [True, False])
def test_only_bundles_are_cleared(tmp_path, finished):
    filled(tmp_path / "x")
    shutil.copytree(tmp_path / "x", tmp_path / ".1234abcd.y")
    (tmp_path / ".1234abcd.y" / "bundle.json").unlink()
    (tmp_path / "mine").mkdir()
    assert list_bundles(tmp_path) == [f"{tmp_path.name}/x"]
    assert list_bundles(tmp_path / "nowhere") == []
    delete_bundles(tmp_path, finished=finished)
    assert {path.name for path in tmp_path.iterdir()} == ({"mine"} if finished else {"mine", "x"})
    delete_bundles(tmp_path / "nowhere", finished=True)


def test_of_a_link_to_a_bundle_only_the_link_is_cleared(tmp_path):
    elsewhere, events = tmp_path / "elsewhere", tmp_path / "events"
    elsewhere.mkdir()
    events.mkdir()
    filled(elsewhere / "x")
    for name in "xy":
        (events / name).symlink_to(elsewhere / "x")
    filled(events / "y")
    delete_bundles(events, finished=True)
    assert not any(events.iterdir())
    assert bundle.open_bundle(elsewhere / "x").begin == 200


def test_behind_a_link_no_bundle_is_cleared_or_replaced(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    filled(tmp_path / "elsewhere" / "x", begin=100)
    (tmp_path / "events").symlink_to("elsewhere")
    delete_bundles(tmp_path / "events", finished=True)
    with pytest.raises(OutputError, match="events is a link"):
        filled(tmp_path / "events" / "x")
    assert bundle.open_bundle(tmp_path / "elsewhere" / "x").begin == 100


def refused(*_):
    raise PermissionError


@pytest.mark.parametrize("linked", [True, False])
def test_copied_bundles_replace_bundles_only(tmp_path, monkeypatch, linked):
    if not linked:
        monkeypatch.setattr(os, "link", refused)
    old, new = tmp_path / "events", tmp_path / "unfinished" / "events"
    for place in (old / "x", old / "y", new / "x", new / "z"):
        place.parent.mkdir(parents=True, exist_ok=True)
        filled(place, begin=100 if place.parent == old else 200)
    (old / "mine").mkdir()
    copy_bundles(new, old)
    assert {path.name for path in old.iterdir()} == {"mine", "x", "z"}
    assert {path.name for path in new.iterdir()} == {"x", "z"}
    assert [bundle.open_bundle(old / name).begin for name in "xz"] == [200, 200]
    assert os.path.samefile(old / "x" / "bundle.json", new / "x" / "bundle.json") == linked
    remove_bundles(new)
    assert not new.parent.exists()
    assert bundle.open_bundle(old / "x").begin == 200
    copy_bundles(new, old)
    assert {path.name for path in old.iterdir()} == {"mine"}


def test_state_digest_covers_values_names_and_types():
    other = (
        ARRAYS | {"b": np.nextafter(ARRAYS["b"], 2)},
        ARRAYS | {"b": ARRAYS["b"].reshape(4, 3)},
        ARRAYS | {"d": np.zeros(0)},
        ARRAYS | {"c": ARRAYS["c"].astype(np.int8)},
        ARRAYS | {"nothing": np.array([-np.nan, -np.inf])},
    )
    digests = {state_digest(arrays) for arrays in (ARRAYS, *other)}
    assert len(digests) == 1 + len(other)
    assert state_digest(dict(reversed(ARRAYS.items()))) == state_digest(ARRAYS)


class Log:
    """Counts of nothing but events, in an order of their own."""

    dt = 0.005

    def __init__(self, events):
        self.events = events

    def log(self):
        return iter(self.events)


def event(monitor, robot, start, joint="elbow", worst=2.0):
    return Event(
        robot=robot,
        monitor=MONITORS[NAMES.index(monitor)],
        joint=joint,
        start=start,
        ticks=1,
        limit=1.0,
        worst=worst,
    )


def test_the_first_of_each_monitor_are_chosen_and_no_more_when_more_come():
    hard = [event("torque", robot, 1000 - 100 * robot) for robot in range(8)]
    soft = [event("tracking", robot, 1000 - 100 * robot) for robot in range(8)]
    found = list(select_events(Log(hard + soft), 8))
    assert [e.start for e in found if e.monitor.hard] == [300 + 100 * k for k in range(HARD_BUNDLES)]
    assert [e.start for e in found if not e.monitor.hard] == [300][:SOFT_BUNDLES]
    later = [replace(e, start=e.start + 800) for e in hard]
    assert list(select_events(Log(hard + later + soft), 8)) == found
    assert {e.robot for e in select_events(Log(hard + soft), 6)} == {5, 4, 3, 2}


def test_simultaneous_joint_failures_are_one_event():
    together = [event("torque", 1, 500, "elbow", 1.1), event("torque", 1, 500, "wrist_1", 1.3)]
    soon, again = event("torque", 1, 699), event("torque", 1, 700)
    elsewhere = event("torque", 2, 501)
    found = list(select_events(Log([again, soon, *together, elsewhere]), 8))
    assert found == [together[1], elsewhere, again]
