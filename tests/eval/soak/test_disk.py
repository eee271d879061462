import errno
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from support.arm6 import SPEC
from support.policies import policy_model, saved

pytest.importorskip("mujoco")

from eval.history.soak_record import Run
from eval.replay import bundle
from eval.replay.bundle_files import new_bundle, write_arrays
from eval.replay.capture_window import columns, window_type, write_mcap
from eval.report import report_files as written
from eval.report.build import build
from eval.shard.job import WIDTH
from eval.soak import cli as command
from eval.soak import workers
from eval.soak.assembly import assemble
from eval.soak.checkpoint import delete_checkpoints, prepare_folder
from eval.soak.disk import check_disk_space, disk_usage, window_bytes
from eval.soak.series import SERIES, series
from eval.soak.tensorboard import TENSORBOARD, event_file
from eval.soak.workers import resumed_ticks, run_soak
from eval.statistics.budget import BUDGET, load_budget
from robots.errors import ConfigError, OutputError
from support.eval.soaks import soak_config, store_ticks

QUIET = Console(quiet=True)
RUN = Run(started="2026-01-01T00:00:00+00:00", wall_s=1.0, hours=0.001, resumed_hours=0.0, interrupted=False)


def size(folder):
    """Bytes of files, each in whole blocks."""
    files = [file for file in Path(folder).rglob("*") if file.is_file()]
    return sum(-(-file.stat().st_size // 4096) * 4096 for file in files)


@pytest.fixture
def restless(tmp_path):
    """A soak of 3.2 s of two shards whose policy throws the arms about."""
    return soak_config(saved(policy_model(), tmp_path), hours=0.0009, robots=WIDTH + 1)


@pytest.mark.slow
def test_soak_writes_no_more_than_estimated(finished, tmp_path):
    soak, shards, out = finished.soak, finished.shards, tmp_path / "out"
    needed = disk_usage(soak)
    written.check_report_folder(out)
    shutil.copytree(finished.kept, out / "unfinished")
    events = size(out / "unfinished" / "events")
    kept = size(out / "unfinished") - events
    assert needed.checkpoints / 2 < kept < needed.checkpoints * 2 / 3  # room for one more of them
    assert 0 < events < needed.events
    bundles = 60 * 2 + 1
    for each in (out / "unfinished" / "events").iterdir():
        assert needed.events / bundles / 10 < size(each) < needed.events / bundles
    before = size(out)
    report = build(assemble(soak, shards, RUN), load_budget(BUDGET))
    beside = {SERIES: series(soak, shards), TENSORBOARD: event_file(soak, shards, RUN.started)}
    beside[bundle.DRAWS] = soak.draws_json(soak.draw_robots()).encode()
    written.write_report(report, out, beside)
    assert size(out) - before < needed.report
    assert size(out) < needed.total
    rows = len(shards[0].running) * soak.robots
    assert len(beside[SERIES]) < 64 * (4096 + 12 * rows)  # as many columns


def test_a_window_of_numbers_that_do_not_compress_is_within_its_bound(restless, tmp_path):
    rng, kind = np.random.default_rng(0), window_type(SPEC, 3)
    rows = np.zeros(round(4 / SPEC.dt), dtype=kind)
    for name in kind.names:
        if rows[name].dtype.kind == "f":
            rows[name] = -1e-200 * rng.normal(size=rows[name].shape)
    rows["tick"], rows["reason"] = np.arange(len(rows)) + 10**8, rng.integers(0, 256, len(rows))
    write_mcap(tmp_path / "w.mcap", SPEC, rows, goal_m=0.02, about={})
    write_arrays(tmp_path / "w.npz", columns(rows))
    found = sum((tmp_path / name).stat().st_size for name in ("w.mcap", "w.npz"))
    assert window_bytes(restless) / 2 < found < window_bytes(restless)


def test_disk_use_is_bounded_after_one_day(restless):
    day, year = (disk_usage(replace(restless, hours=hours, robots=16)) for hours in (24.0, 8760.0))
    assert day.total == pytest.approx(year.total, rel=0.001)
    assert day.hourly == pytest.approx(8760 / 24 * year.hourly, rel=0.001)
    hour = disk_usage(replace(restless, hours=1.0, robots=16))
    assert day.total - hour.total == pytest.approx(23 * 16 * day.hourly, rel=0.02)


@pytest.mark.slow
def test_a_soak_that_does_not_fit_is_refused_with_both_numbers(restless, tmp_path, monkeypatch, capsys):
    needed, out = disk_usage(restless), tmp_path / "out"
    out.mkdir()
    asked = (restless, out, out / "unfinished", Console(width=400))
    usage = SimpleNamespace(free=needed.total)
    monkeypatch.setattr(shutil, "disk_usage", lambda place: usage)
    check_disk_space(*asked)
    said = rf"disk: at most {needed.total / 1e6:.1f} MB: .* for each simulated hour of a robot"
    assert re.search(said, capsys.readouterr().out)
    usage.free -= 10**7
    wanted, there = f"{needed.total / 1e6:.1f} MB", f"{usage.free / 1e6:.1f} MB"
    with pytest.raises(OutputError, match=f"--out {out}: found {there} free, expected {wanted}"):
        check_disk_space(*asked)
    prepare_folder(out / "unfinished")  # what an earlier start left there is part of it
    (out / "unfinished" / "shard-0000.npz").write_bytes(bytes(10**7))
    check_disk_space(*asked)


@pytest.mark.slow
def test_lost_report_folder_is_an_error_and_not_recreated(restless, tmp_path, monkeypatch):
    """It is moved away once the soak has begun; when it is put back, the soak goes on from there."""
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    restless, run = replace(restless, hours=0.0002), workers.WorkerPool.run
    written.check_report_folder(out)
    first = store_ticks(restless, 0, out / "unfinished", restless.ticks)
    monkeypatch.setattr(workers.WorkerPool, "run", lambda pool: (out.rename(elsewhere), run(pool)))
    lost = f"{first.path}: cannot be written: {out / 'unfinished'} was deleted"
    with pytest.raises(OutputError, match=lost):
        run_soak(restless, out / "unfinished", QUIET)
    assert not out.exists()
    assert restless.checkpoint(0, elsewhere / "unfinished").load() is not None
    elsewhere.rename(out)
    assert resumed_ticks(restless, out / "unfinished", QUIET) == restless.ticks


def test_lost_shard_is_an_error_and_not_omitted(restless, tmp_path, monkeypatch):
    monkeypatch.setattr(workers.WorkerPool, "run", lambda pool: pool.pending.clear())
    with pytest.raises(OutputError, match=r"shard-0000\.npz: lost"):
        run_soak(restless, tmp_path / "unfinished", QUIET)


def test_no_bundle_is_written_into_a_lost_folder(tmp_path):
    with (
        pytest.raises(OutputError, match="cannot be written: No such file"),
        new_bundle(tmp_path / "out" / "events" / "x"),
    ):
        pass
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_read_only_folder_is_an_error_before_the_soak(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="cannot be written: Permission denied"):
        prepare_folder(tmp_path / "unfinished")


def denied(*_, **__):
    raise PermissionError(errno.EACCES, "Permission denied")


def test_denied_file_access_is_reported(restless, tmp_path, monkeypatch):
    checkpoint = store_ticks(restless, 0, tmp_path / "unfinished", 400)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", denied)
        patch.setattr(Path, "touch", denied)
        with pytest.raises(OutputError, match=r"unfinished: cannot be written: Permission denied"):
            prepare_folder(tmp_path / "unfinished")
        with pytest.raises(OutputError, match=r"shard-0000\.npz: cannot be written: Permission denied"):
            checkpoint.store({})
    with monkeypatch.context() as patch:
        patch.setattr(Path, "stat", lambda path, **_: denied() if path == checkpoint.path else os.stat(path))
        with pytest.raises(ConfigError, match=r"shard-0000\.npz: cannot be read: Permission denied"):
            resumed_ticks(restless, tmp_path / "unfinished", QUIET)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", denied)
        with pytest.raises(OutputError, match=r"shard-0000\.npz: cannot be deleted: Permission denied"):
            delete_checkpoints(tmp_path / "unfinished")
    assert resumed_ticks(restless, tmp_path / "unfinished", QUIET) == 400


def test_wrong_file_type_in_place_of_series_or_trends_is_an_error_before_the_soak(tmp_path):
    (tmp_path / "tensorboard").touch()
    with pytest.raises(OutputError, match="tensorboard: cannot be written: File exists, expected a folder"):
        written.check_report_folder(tmp_path, (SERIES, TENSORBOARD))
    (tmp_path / "tensorboard").unlink()
    (tmp_path / SERIES).mkdir()
    with pytest.raises(OutputError, match=r"series\.parquet: found a folder, expected a file"):
        written.check_report_folder(tmp_path, (SERIES, TENSORBOARD))


def test_partial_files_of_a_killed_start_are_removed(tmp_path):
    prepare_folder(tmp_path / "unfinished")
    for name in ("shard-0000.npz", ".0123abcd.shard-0000.npz", "shard-0001.npz.damaged"):
        (tmp_path / "unfinished" / name).write_bytes(b"x")
    prepare_folder(tmp_path / "unfinished")
    assert {file.name for file in (tmp_path / "unfinished").iterdir()} == {
        "shard-0000.npz",
        "shard-0001.npz.damaged",
    }


@pytest.mark.slow
def test_full_disk_at_the_end_keeps_the_soak(call, arm_policy, tmp_path, monkeypatch):
    out = tmp_path / "out"
    options = ("--policy", arm_policy, "--hours", 0.0003, "--robots", 2, "--workers", 1, "--out", out)

    def full(path, data):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        code, _, said = call(command.cli, *options)
    assert code == 1
    assert re.fullmatch(
        rf"error: not kept: --out {out}/\S+: cannot be written: No space left on device\n"
        "the same command goes on from the last checkpoints\n",
        said,
    )
    assert {file.name for file in out.iterdir()} == {"unfinished"}
    code, said, _ = call(command.cli, *options)
    assert code == 1
    assert "resuming after 0.0003 of 0.0003 hours" in said
    assert {file.name for file in out.iterdir()} == {
        *("draws.json", "report.json", "report.html", "junit.xml"),
        *("series.parquet", "tensorboard"),
    }
    assert [file.name for file in (out / "tensorboard").iterdir()] == ["events.out.tfevents.soak"]
