import json
import multiprocessing as mp
import os
import signal
import zipfile
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from rich.console import Console

from support.policies import policy_model, saved

pytest.importorskip("mujoco")

from deploy.telemetry.plain_console import plain_console
from eval.shard.job import ARM_S, WIDTH, code_digest
from eval.shard.shard import Shard
from eval.soak import workers
from eval.soak.checkpoint import DAMAGED, NAME, Checkpoint, delete_checkpoints, prepare_folder
from eval.soak.worker_pool import WorkerPool
from robots.errors import ConfigError, OutputError
from support.eval.soaks import soak_config, store_ticks

IDENTITY = {"seed": 7, "robot_digest": "abc"}
ARRAYS = {"judge.ticks": np.arange(5), "robot.goal": np.array([[0.1, np.nan, -np.inf]])}


@pytest.fixture
def restless(tmp_path):
    """A soak of 4.7 s of two shards whose policy throws the arms about."""
    return soak_config(saved(policy_model(), tmp_path), hours=0.0013, robots=WIDTH + 1)


def assert_same(a, b):
    """Two saved shards, bit for bit."""
    assert a.keys() == b.keys()
    for name, array in a.items():
        np.testing.assert_array_equal(array, b[name], err_msg=name)
        assert array.dtype == b[name].dtype


def test_checkpoint_round_trips_bit_for_bit(tmp_path):
    checkpoint = Checkpoint(tmp_path / "unfinished" / "a.npz", IDENTITY)
    assert checkpoint.load() is None
    prepare_folder(tmp_path / "unfinished")
    checkpoint.store({"judge.ticks": np.zeros(3)})
    checkpoint.store(ARRAYS)
    assert_same(Checkpoint(checkpoint.path, IDENTITY).load(), ARRAYS)
    assert [file.name for file in checkpoint.path.parent.iterdir()] == ["a.npz"]


@pytest.mark.parametrize("change", [{"seed": 8}, {"hours": 1}])
def test_checkpoint_of_another_soak_is_refused(tmp_path, change):
    Checkpoint(tmp_path / "a.npz", IDENTITY).store(ARRAYS)
    (key,) = change
    found, expected = IDENTITY.get(key), change[key]
    with pytest.raises(
        ConfigError, match=rf"a\.npz: {key}: found {found}, expected {expected}: .* another --out"
    ):
        Checkpoint(tmp_path / "a.npz", IDENTITY | change).load()
    assert (tmp_path / "a.npz").exists()


def test_names_of_another_soak_cannot_control_a_terminal(tmp_path):
    checkpoint = Checkpoint(tmp_path / "a.npz", IDENTITY)
    Checkpoint(checkpoint.path, IDENTITY | {"a\nb": "\x1b" * 9999}).store(ARRAYS)
    with pytest.raises(ConfigError, match=r"a\.npz: a\?b: found \?{200}, expected None: [^\n]*$"):
        checkpoint.load()


def flipped(data):
    place = data.index(b"judge.ticks") + 200
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


def another_method(data):
    """Of compression, in the directory at the end."""
    place = data.index(b"PK\x01\x02") + 10
    return data[:place] + bytes([12]) + data[place + 1 :]


def again(data, save=np.savez, **changes):
    """Written again, with other arrays."""
    with np.load(BytesIO(data)) as file:
        arrays = dict(file) | changes
    stream = BytesIO()
    save(stream, **{name: array for name, array in arrays.items() if array is not None})
    return stream.getvalue()


def huge(_):
    """By its header."""
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w") as file, file.open("a.npy", "w") as array:
        header = {"descr": "<f8", "fortran_order": False, "shape": (1 << 42,)}
        np.lib.format.write_array_header_1_0(array, header)
    return stream.getvalue()


SPOILT = {
    "cut": lambda data: data[: len(data) // 2],
    "flipped": flipped,
    "empty": lambda _: b"",
    "nameless": lambda data: again(data, identity=None),
    "edited": lambda data: again(data, **{"judge.ticks": ARRAYS["judge.ticks"] + 1}),
    "another method": another_method,
    "compressed": lambda data: again(data, np.savez_compressed),
    "huge": huge,
    "list": lambda data: again(data, identity=np.array("[7]")),
    "pairs": lambda data: again(data, identity=np.array("[[1, 2]]")),
    "pickled": lambda data: again(data, identity=np.array([{}], dtype=object)),
}


def spoil(path, how):
    path.write_bytes(SPOILT[how](path.read_bytes()))


@pytest.mark.parametrize("how", SPOILT)
def test_damaged_checkpoint_is_set_aside(tmp_path, how):
    checkpoint = Checkpoint(tmp_path / NAME.format(0), IDENTITY)
    checkpoint.store(ARRAYS)
    spoil(checkpoint.path, how)
    data = checkpoint.path.read_bytes()
    assert checkpoint.load() is None
    assert not checkpoint.path.exists()
    assert (tmp_path / (NAME.format(0) + DAMAGED)).read_bytes() == data
    checkpoint.store(ARRAYS)
    delete_checkpoints(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == [NAME.format(0) + DAMAGED]


def test_only_checkpoints_are_deleted_with_them(tmp_path):
    """Files of others stay, and their folder."""
    folder = tmp_path / "unfinished"
    folder.mkdir()
    for name in (NAME.format(0), "notes.npz", ".a.npz"):
        (folder / name).touch()
    prepare_folder(folder)
    delete_checkpoints(folder)
    assert {file.name for file in folder.iterdir()} == {"notes.npz", ".a.npz"}
    for name in ("notes.npz", ".a.npz"):
        (folder / name).unlink()
    delete_checkpoints(folder)
    assert not folder.exists()


def test_behind_a_link_no_checkpoint_is_deleted_or_replaced(tmp_path):
    """A checkpoint of somebody else's soak."""
    other, link = tmp_path / "other", tmp_path / "unfinished"
    other.mkdir()
    link.symlink_to(other)
    (other / NAME.format(0)).write_bytes(b"theirs")
    delete_checkpoints(link)
    with pytest.raises(OutputError, match=r"unfinished is a link"):
        Checkpoint(link / NAME.format(0), IDENTITY).store(ARRAYS)
    assert (other / NAME.format(0)).read_bytes() == b"theirs"
    assert link.is_symlink()


def test_number_of_arrays_is_bounded(tmp_path, monkeypatch):
    checkpoint = Checkpoint(tmp_path / "a.npz", IDENTITY)
    checkpoint.store(ARRAYS)
    monkeypatch.setattr("robots.archives.MEMBERS_MAX", len(ARRAYS) + 2)
    assert_same(checkpoint.load(), ARRAYS)
    monkeypatch.setattr("robots.archives.MEMBERS_MAX", len(ARRAYS) + 1)
    assert checkpoint.load() is None


def test_unreadable_checkpoint_is_left_in_place(tmp_path):
    (tmp_path / "a.npz").mkdir()
    with pytest.raises(ConfigError, match=r"a\.npz: cannot be read: Is a directory"):
        Checkpoint(tmp_path / "a.npz", IDENTITY).load()
    assert (tmp_path / "a.npz").exists()


def test_failed_write_keeps_the_old_checkpoint(tmp_path, monkeypatch):
    checkpoint = Checkpoint(tmp_path / "a.npz", IDENTITY)
    checkpoint.store(ARRAYS)

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OutputError, match=r"a\.npz: cannot be written: No space left on device"):
        checkpoint.store({"judge.ticks": np.zeros(5)})
    assert_same(checkpoint.load(), ARRAYS)
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.slow
def test_resumed_shard_is_bit_identical(restless):
    """Kept in the midst of stops, latches and goals, and restored into another process' place."""
    job = replace(restless.jobs()[0], ticks=1000, sample_ticks=90)
    whole, first, second = Shard(job), Shard(job), Shard(job)
    kept = []
    whole.run(lambda _: None, lambda: False)
    seen = []
    first.run(seen.append, lambda: seen[-1] >= 400, lambda: kept.append(first.save()))
    assert int(kept[-1]["runtime.ticks"]) == 400
    second.restore(kept[-1])
    result = second.run(lambda _: None, lambda: False)
    assert_same(second.save(), whole.save())
    assert result.counts.stops.sum() > 0


def test_a_shard_that_goes_back_around_its_arming_comes_to_the_same(restless):
    shard, armed = Shard(restless.jobs()[0]), round(ARM_S / restless.spec.dt)
    kept = []
    while shard.runtime.ticks < armed + 60:
        kept.append(shard.snapshot())
        shard.tick()
    expected = shard.snapshot()
    assert shard.runtime.supervisor.powered.any()
    for begin in range(armed - 2, armed + 3):
        shard.resimulate(kept[begin], lambda: None)
        assert_same(shard.snapshot(), expected)


def test_code_digest_is_part_of_the_identity(restless, tmp_path):
    identity = restless.checkpoint(1, tmp_path).identity
    assert identity["code_digest"] == code_digest()
    assert len(code_digest()) == 64
    assert identity["first"] == WIDTH
    assert json.loads(json.dumps(identity)) == identity


@pytest.mark.slow
def test_killed_worker_changes_no_result(finished, tmp_path, monkeypatch, capsys):
    """It is killed in the midst of the first shard, as the system does it; the second has a checkpoint already."""
    soak = finished.soak

    def kill(pool, step=WorkerPool.step):
        step(pool)
        if sum(pool.progress):
            for child in mp.active_children():
                os.kill(child.pid, signal.SIGKILL)
            patch.undo()

    prepare_folder(tmp_path)
    shard = Shard(soak.jobs()[1])
    shard.run(lambda _: None, lambda: shard.runtime.ticks >= 200)
    soak.checkpoint(1, tmp_path).store(shard.save())
    with monkeypatch.context() as patch:
        patch.setattr(WorkerPool, "step", kill)
        disturbed = workers.run_soak(soak, tmp_path, Console())
    assert "a worker died: its shard resumes from its checkpoint" in capsys.readouterr().out
    assert len(finished.shards) == len(disturbed) == 2
    for number in (0, 1):
        assert_same(*(soak.checkpoint(number, folder).load() for folder in (finished.kept, tmp_path)))
    assert workers.resumed_ticks(soak, tmp_path, Console(quiet=True)) == 2 * soak.ticks


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays: arrays.pop("judge.attempted"),
        lambda arrays: arrays.pop("sampled.winding_c"),
        lambda arrays: arrays.update({"sampled.winding_c": np.zeros(3)}),
        lambda arrays: arrays.update({"runtime.ticks": arrays["runtime.ticks"] - 1}),
        lambda arrays: arrays.pop("runtime.ticks"),
        lambda arrays: arrays.update({"runtime.ticks": np.zeros(3, dtype=int)}),
    ],
)
def test_a_checkpoint_that_is_replaced_while_the_soak_runs_is_an_error(
    finished, tmp_path, monkeypatch, change
):
    soak = finished.soak
    monkeypatch.setattr(workers.WorkerPool, "run", lambda pool: pool.pending.clear())
    for number, _ in enumerate(soak.jobs()):
        arrays = dict(soak.checkpoint(number, finished.kept).load())
        change(arrays)
        soak.checkpoint(number, tmp_path).store(arrays)
    with pytest.raises(OutputError, match=r"shard-0000\.npz: replaced while the soak ran$"):
        workers.run_soak(soak, tmp_path, Console(quiet=True))


def test_damage_is_reported_before_the_soak_runs(restless, tmp_path, capsys):
    kept = store_ticks(restless, 1, tmp_path / "a[/x]", 400)
    assert workers.resumed_ticks(restless, kept.path.parent, plain_console()) == 400
    spoil(kept.path, "cut")
    assert_reported(restless, kept, capsys)


def assert_reported(soak, kept, capsys):
    assert workers.resumed_ticks(soak, kept.path.parent, plain_console()) == 0
    said = capsys.readouterr().out.replace("\n", "")
    assert f"{kept.path}: damaged and renamed: its robots start again" in said
    assert [file.name for file in kept.path.parent.iterdir()] == [kept.path.name + DAMAGED]


@pytest.mark.parametrize(
    "change",
    [
        {"runtime.ticks": None},
        {"runtime.ticks": np.array([400])},
        {"runtime.ticks": np.array("400")},
        {"runtime.ticks": np.array(400.0)},
        {"runtime.ticks": np.array(400, np.int32)},
        {"runtime.ticks": np.array(-1)},
        {"runtime.ticks": np.array(10**18)},
        {"judge.worst": None},
        {"judge.worst": np.zeros(1)},
        {"robot.plant.tick": np.array(["400"])},
        {"sampled.stops": np.zeros((1, 1), np.int64)},
        {"more": np.zeros(1)},
    ],
    ids=str,
)
def test_arrays_of_another_kind_are_damage(restless, tmp_path, capsys, change):
    """Under the right identity and digest."""
    kept = store_ticks(restless, 1, tmp_path / "unfinished", 400)
    arrays = kept.load() | change
    kept.store({name: array for name, array in arrays.items() if array is not None})
    assert_reported(restless, kept, capsys)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("runtime.supervisor.mode", 99),
        ("judge.invalid", -1),
        ("judge.events.start", 2**62),
        ("judge.events.channel", -2),
        ("sampled.stops", -1),
        ("responses.slot", 99),
        ("robot.plant.tick", 2**63 - 1),
        ("robot.plant.housings.celsius", -1e308),
        ("judge.worst", 1e308),
        ("sampled.folded_back", 1.5),
        ("sampled.folded_back", -0.5),
        ("runtime.estimator.windings.foldback.current_share", -1e12),
    ],
)
def test_numbers_that_no_shard_has_are_damage(restless, tmp_path, capsys, name, value):
    """Under the right identity and digest, too."""
    kept = store_ticks(restless, 1, tmp_path / "unfinished", 400)
    arrays = kept.load()
    arrays[name][...] = value
    kept.store(arrays)
    assert_reported(restless, kept, capsys)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_no_damage(restless, tmp_path, value):
    """A simulation that diverged, or a limit that nobody knows, leaves some."""
    kept = store_ticks(restless, 1, tmp_path, 400)
    arrays = kept.load()
    arrays["judge.worst"][0] = value
    arrays["sampled.folded_back"][0, 0] = np.nan
    kept.store(arrays)
    assert workers.resumed_ticks(restless, tmp_path, Console(quiet=True)) == 400
