import errno
import json
import os
import resource
import subprocess
import sys
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from support.arm6 import SPEC
from support.eval.shards import job

pytest.importorskip("mujoco")

from deploy.start import LACKING
from deploy.telemetry.folder_lock import LOCK, locked
from eval.history.soak_record import Run
from eval.report.report_files import check_report_folder, delete_report
from eval.shard import shard as shard_module
from eval.shard.job import WIDTH, code_digest
from eval.shard.judging import COUNTED
from eval.shard.shard import Shard
from eval.soak import cli as command
from eval.soak.assembly import assemble
from eval.soak.checkpoint import NAME, prepare_folder
from eval.soak.tensorboard import TENSORBOARD
from eval.soak.worker_pool import WorkerPool
from eval.soak.workers import run_soak
from robots.errors import ConfigError, OutputError
from support.eval.reports import report
from support.eval.soaks import soak_config
from support.refusals import in_use

CONSOLE = Console(quiet=True)
ROBOTS = WIDTH + 2
RUN = Run(started="2026-01-01T00:00:00+00:00", wall_s=1.0, hours=0.001, resumed_hours=0.0, interrupted=False)

FILES = {"report.json", "report.html", "junit.xml", "draws.json", "series.parquet", "tensorboard"}


@pytest.fixture
def asked(arm_policy):
    """A soak of 2.2 s of two shards, the second not full."""

    return partial(soak_config, arm_policy, hours=0.0006, robots=ROBOTS)


def assert_same(a, b):
    """Two results of shards, bit for bit."""
    for one, other in zip(a, b, strict=True):
        for field in fields(one.counts):
            np.testing.assert_array_equal(getattr(one.counts, field.name), getattr(other.counts, field.name))
        for name in ("winding_c", "worn", "folded_back", "events", *COUNTED):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.slow
def test_results_do_not_depend_on_workers(finished, tmp_path):
    one = finished.shards
    assert_same(one, run_soak(replace(finished.soak, workers=2), tmp_path, CONSOLE))
    counts = [shard.counts for shard in one]
    assert [each.robots for each in counts] == [WIDTH, ROBOTS - WIDTH]
    for each in counts:
        assert (each.moving > 50).all()
        assert (each.attempted == 1).all()
    assert sum(each.stops.sum() for each in counts) > 10
    assert (one[0].winding_c[-1] > one[0].winding_c[0]).mean() > 0.3
    friction, backlash, encoder, constant = one[0].worn[-1] - one[0].worn[0]
    assert (friction > 0).all()
    assert (backlash > 0).all()
    assert (encoder != 0).all()
    assert (constant < 0).all()


def lived(shard_job, stop_at=None):
    seen = []
    result = Shard(shard_job).run(seen.append, lambda: stop_at is not None and seen[-1] >= stop_at)
    return result, seen


@pytest.fixture(scope="module")
def whole(arm_policy):
    """An idle shard, all of whose robots count."""
    return lived(job(arm_policy))[0]


@pytest.mark.slow
def test_uncounted_robots_change_nothing(arm_policy, whole):
    some, _ = lived(job(arm_policy, robots=3))
    assert some.counts.robots == 3
    np.testing.assert_array_equal(some.counts.worst, whole.counts.worst[:3])
    np.testing.assert_array_equal(some.winding_c, whole.winding_c[:, :3])
    np.testing.assert_array_equal(some.worn, whole.worn[:, :, :3])
    assert some.attempted[-1].tolist() == [1, 1, 1]


@pytest.mark.slow
def test_a_stopped_shard_reports_what_was_done(arm_policy, whole):
    result, seen = lived(job(arm_policy), stop_at=400)
    assert seen == [0, 200, 400, 400]
    assert (result.counts.ticks == 400).all()
    assert len(result.winding_c) == 5
    np.testing.assert_array_equal(result.winding_c, whole.winding_c[:5])
    np.testing.assert_array_equal(result.worn, whole.worn[:5])


def test_robots_start_unworn(arm_policy):
    shard = Shard(job(arm_policy, ticks=1))
    friction, backlash, encoder, constant = shard.run(lambda ticks: None, lambda: False).worn[0]
    np.testing.assert_array_equal(friction, 1.0)
    np.testing.assert_array_equal(backlash, shard.runtime.robot.draw["joints.backlash_rad"])
    np.testing.assert_array_equal(encoder, 0.0)
    np.testing.assert_array_equal(constant, 1.0)


def test_wear_samples_are_nan_where_the_simulation_diverged(arm_policy):
    shard = Shard(job(arm_policy, ticks=1))
    plant = shard.runtime.robot.plant
    plant.wear.life[:] = np.linspace(0.1, 2.0, WIDTH)[:, None]
    plant.valid[2] = False
    expected = np.stack(plant.wear.worn())
    expected[:, 2] = np.nan
    found = shard.run(lambda ticks: None, lambda: False)
    np.testing.assert_array_equal(found.worn[0], expected)
    assert np.isnan(found.winding_c[0]).all(axis=1).tolist() == [row == 2 for row in range(WIDTH)]


@pytest.mark.slow
def test_operator_rearms_latched_robots(arm_policy, monkeypatch):
    """After a minute; here after 5 s, of which a hot housing takes half to cool."""
    assert shard_module.OPERATOR_S == 60.0
    monkeypatch.setattr(shard_module, "OPERATOR_S", 5.0)
    shard = Shard(job(arm_policy, ticks=1600))
    housing = shard.runtime.robot.plant.housing
    housing[2, 1] = 95.0
    result = shard.run(
        lambda ticks: housing.__setitem__((2, 1), 30.0) if ticks == 400 else None, lambda: False
    )
    assert (result.counts.running > 1400).tolist() == [row != 2 for row in range(WIDTH)]
    assert 0 < result.counts.running[2] < 600


def test_stops_are_sampled_as_running_totals(arm_policy):
    shard = Shard(job(arm_policy, ticks=1, robots=3))
    shard.judge.stops[:], shard.judge.latches[:] = (4, 0, 2), (1, 0, 0)
    found = shard.run(lambda ticks: None, lambda: False)
    assert (found.stops.tolist(), found.latches.tolist()) == ([[4, 0, 2]], [[1, 0, 0]])


@pytest.mark.slow
def test_results_of_shards_are_joined_and_goals_binned(finished):
    soak, shards = finished.soak, finished.shards
    result = assemble(soak, shards, RUN)
    assert result.winding_c.shape == (len(result.sample_h), ROBOTS, SPEC.n)
    assert result.worn.shape == (len(result.sample_h), 4, ROBOTS, SPEC.n)
    assert np.isfinite(result.winding_c).all()
    np.testing.assert_array_equal(result.worn[:, :, WIDTH:], shards[1].worn)
    assert result.sample_h[0] == 0.0
    assert result.sample_h[-1] == pytest.approx(soak.hours, rel=0.05)
    assert result.goals_attempted.sum() == result.counts.attempted.sum() == ROBOTS
    assert (result.goals_reached <= result.goals_attempted).all()
    assert len(result.goals_attempted) <= 8
    assert result.stops.shape == result.latches.shape == (len(result.sample_h), ROBOTS)
    np.testing.assert_array_equal(result.parameters["payload.mass_kg"], soak.draw_robots()["payload.mass_kg"])
    assert {len(column) for column in result.parameters.values()} == {ROBOTS}


@pytest.mark.slow
def test_interrupted_shard_leaves_nan_samples(arm_policy, asked):
    short, _ = lived(job(arm_policy, ticks=1000, first=WIDTH), stop_at=400)
    short = replace(short, stops=np.outer(range(5), range(WIDTH)))
    whole, _ = lived(job(arm_policy, ticks=1000))
    result = assemble(asked(), [whole, short], RUN)
    for unknown in (result.winding_c[5:, WIDTH:], result.worn[5:, :, WIDTH:]):
        assert unknown.size
        assert np.isnan(unknown).all()
    assert np.isfinite(result.winding_c[:5]).all()
    assert np.isfinite(result.worn[:, :, :WIDTH]).all()
    assert np.isfinite(result.worn[:5]).all()
    assert result.goals_attempted.sum() == whole.attempted[-1].sum() + short.attempted[-1].sum()
    assert (result.stops[[0, 3, 4, -1], -1] == np.array([0, 3, 4, 4]) * (WIDTH - 1)).all()


@pytest.fixture
def soak_test(call, arm_policy, tmp_path):
    """`soak-test` with the idle policy into `tmp_path / "out"`: exit code, standard output and standard error."""
    return partial(call, command.cli, "--policy", arm_policy, "--out", tmp_path / "out")


@pytest.mark.slow
def test_an_idle_policy_fails_the_budget(arm_policy, tmp_path):
    """In a process of its own, with the shipped budget; long enough that the start takes less than 1 % of the time.

    The computer's time zone, a day from UTC, is none that ISO 8601 can express.
    """
    sizes = ("--hours", "0.0085", "--robots", "4", "--workers", "1")
    script = "from eval.soak.cli import cli; cli()"
    options = ("--policy", arm_policy, *sizes, "--out", tmp_path / "out")
    environment = os.environ | {"TZ": "XXX24"}
    done = subprocess.run(
        [sys.executable, "-c", script, *options],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (1, "")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["verdict"] == "failed"
    assert report["run"]["started"].endswith("+00:00")
    assert report["goals"]["success"] < 0.1
    assert [line["name"] for line in report["budget"] if not line["passed"]] == ["goal_success"]
    assert "\nbudget: goal_success: found 0" in done.stdout
    assert done.stdout.count("\nbudget: ") == 1
    assert report["exposure"]["evaluations"] == 4 * 6120
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES


def impatient(pool, step=WorkerPool.step):
    """Somebody who presses Ctrl-C as soon as anything is done."""
    step(pool)
    if sum(pool.progress):
        raise KeyboardInterrupt


@pytest.mark.slow
def test_ctrl_c_keeps_a_partial_report(soak_test, tmp_path, monkeypatch):
    monkeypatch.setattr(WorkerPool, "step", impatient)
    assert soak_test("--hours", 100, "--robots", 24, "--workers", 1)[0] == 130
    report = json.loads((tmp_path / "out" / "unfinished" / "report.json").read_text())
    assert report["verdict"] == "interrupted"
    assert report["exposure"]["draws"] == WIDTH
    assert 0 < report["run"]["hours"] < 100


def interrupted(pool, step=WorkerPool.step):
    step(pool)
    raise KeyboardInterrupt


def begun(config, folder, console):
    """A soak that was started before: its shard goes on from a checkpoint, up to where it hears of Ctrl-C."""
    shard = Shard(config.jobs()[0])
    shard.run(lambda _: None, lambda: shard.runtime.ticks >= 200)
    prepare_folder(folder)
    config.checkpoint(0, folder).store(shard.save())
    return run_soak(config, folder, console)


@pytest.mark.slow
def test_finished_soak_is_replaced_by_a_finished_soak_only(soak_test, tmp_path, monkeypatch):
    """Begun over one, interrupted, taken up, and ended."""
    out = tmp_path / "out"
    former = {*FILES - {"tensorboard"}, TENSORBOARD, "events/old/bundle.json", "events/mine/note.txt"}
    for name in former:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("before")

    def ended():
        code, *_ = soak_test("--hours", 0.001, "--robots", 1, "--workers", 1)
        return code, {path.relative_to(out).as_posix(): path for path in out.rglob("*") if path.is_file()}

    with monkeypatch.context() as patch:
        patch.setattr(WorkerPool, "step", interrupted)
        patch.setattr(command, "run_soak", begun)
        code, files = ended()
    assert code == 130
    assert {name for name in files if not name.startswith("unfinished/")} == former
    assert {files[name].read_text() for name in former} == {"before"}
    assert {f"unfinished/{name}" for name in (*FILES - {"tensorboard"}, TENSORBOARD)} < set(files)
    (out / "unfinished" / "events" / "new").mkdir(parents=True)
    (out / "unfinished" / "events" / "new" / "bundle.json").write_text("of its first part")
    code, files = ended()
    assert code == 1
    assert set(files) == former - {"events/old/bundle.json"} | {"events/new/bundle.json"}
    assert json.loads(files["report.json"].read_text())["verdict"] == "failed"
    assert {name for name, path in files.items() if path.read_bytes() == b"before"} == {
        "events/mine/note.txt"
    }
    assert not (out / "unfinished").exists()


@pytest.mark.parametrize(
    ("what", "named"),
    [
        ("policy", r"\w+\.onnx"),
        ("robot", "arm6"),
        ("draws", r"arm6/draws\.toml"),
        ("limits", r"arm6/limits\.toml"),
        ("code", "firstshift's code"),
    ],
)
def test_change_during_the_soak_is_refused(arm_policy, what, named):
    said = rf"{named}: changed during the soak: digest found \w{{12}}, expected 0{{12}}$"
    with pytest.raises(ConfigError, match=said):
        Shard(job(arm_policy, **{f"{what}_digest": "0" * 64}))


def test_a_policy_that_changed_is_not_loaded(arm_policy, monkeypatch):
    """Its graph was tried in no other process."""
    changed = job(arm_policy, policy_digest="0" * 64)
    monkeypatch.setattr("onnxruntime.InferenceSession", lambda *_, **__: pytest.fail("it was loaded"))
    with pytest.raises(ConfigError, match="changed during the soak"):
        Shard(changed)


def test_settings_are_text_whatever_bytes_an_argument_has(asked, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["soak-test", "--out", "o_\udcff"])
    soak = replace(asked(), budget=Path("b_\udcff.toml"))
    assert '"soak-test --out o_?"' in soak.settings().model_dump_json()


def test_deleted_working_directory_is_named(asked, tmp_path, monkeypatch):
    soak = asked()
    monkeypatch.chdir(tmp_path)
    tmp_path.rmdir()
    with pytest.raises(ConfigError, match="the working directory was deleted"):
        soak.settings()


def test_jobs_carry_the_digests_of_the_start(asked):
    soak = asked()
    settings = soak.settings()
    for each in soak.jobs():
        assert each.code_digest == code_digest()
        assert (each.draws_digest, each.limits_digest) == (settings.draws_digest, settings.limits_digest)


BAD = {
    "hours": (("--hours", 0), "--hours: found 0.0, expected above 0"),
    "robots": (("--robots", 0), "--robots: found 0, expected from 1"),
    "seed": (("--seed", -1), "--seed: found -1, expected from 0 to "),
    "large seed": (
        ("--seed", 2**63),
        "--seed: found 9223372036854775808, expected from 0 to 9223372036854775807",
    ),
    "workers": (("--workers", 0), "--workers: found 0, expected from 1"),
    "robot": (("--robot", "hexapod"), "--robot hexapod: no such folder with a robot.toml; known: arm6"),
    "long name": (("--robot", "x" * 5000), "no such folder with a robot.toml"),
    "policy": (("--policy", "nothing.onnx"), "nothing.onnx: cannot be read"),
    "budget": (("--budget", "nothing.toml"), "nothing.toml: cannot be read"),
    "out": (("--out", "/dev/null/soak"), "--out /dev/null/soak"),
}


@pytest.mark.parametrize(("options", "message"), BAD.values(), ids=BAD)
def test_bad_input_names_the_expected_value(soak_test, tmp_path, options, message):
    code, _, said = soak_test("--hours", 0.001, *options)
    assert code == 2
    assert message in said
    assert not list(tmp_path.glob("out/*"))


@pytest.fixture
def small_disk():
    """No file may grow beyond 1 MB, here and in workers."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.slow
@pytest.mark.usefixtures("small_disk")
def test_full_disk_is_exit_1_and_names_what_is_lost(soak_test, tmp_path):
    code, _, said = soak_test("--hours", 0.001, "--robots", 1, "--workers", 1)
    place = tmp_path / "out" / "unfinished" / "shard-0000.npz"
    assert code == 1
    assert said.splitlines() == [
        f"error: not kept: --out {place}: cannot be written: File too large",
        "the same command goes on from the last checkpoints",
    ]


def test_bundles_of_a_former_soak_that_stay_keep_the_checkpoints(tmp_path, monkeypatch):
    """And no record is added: the same command does it again."""
    checkpoint, history = tmp_path / "unfinished" / NAME.format(0), tmp_path / "history"
    for path in (checkpoint, tmp_path / "events" / "old" / "bundle.json"):
        path.parent.mkdir(parents=True)
        path.touch()

    def denied(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("shutil.rmtree", denied)
    with pytest.raises(OutputError, match=r"events/old: cannot be deleted: Permission denied"):
        command._write(report(), {}, tmp_path, history)
    assert checkpoint.exists()
    assert not history.exists()


@pytest.mark.parametrize("last", ["copy_bundles", "delete_report", "delete_checkpoints", "remove_bundles"])
def test_bundles_survive_a_kill_while_the_report_is_written(tmp_path, monkeypatch, last):
    """They are in their place before the checkpoints, from which they would come again, are deleted."""
    checkpoint, new = tmp_path / "unfinished" / NAME.format(0), tmp_path / "unfinished" / "events" / "new"
    for path in (checkpoint, new / "bundle.json", tmp_path / "events" / "old" / "bundle.json"):
        path.parent.mkdir(parents=True)
        path.touch()

    ended = getattr(command, last)

    def killed(*words):
        ended(*words)
        raise SystemExit

    monkeypatch.setattr(command, last, killed)
    with pytest.raises(SystemExit):
        command._write(report(), {}, tmp_path, None)
    assert checkpoint.exists() == (last in ("copy_bundles", "delete_report"))
    assert new.exists() == (last != "remove_bundles")
    assert [path.name for path in (tmp_path / "events").iterdir()] == ["new"]
    command.delete_bundles(new.parent, finished=True)  # as the next soak does without checkpoints
    assert (tmp_path / "events" / "new" / "bundle.json").exists()


@pytest.mark.parametrize("name", ["unfinished", "events"])
def test_a_file_in_the_place_of_a_folder_is_exit_2(soak_test, tmp_path, name):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("mine")
    code, _, said = soak_test("--hours", 0.001, "--robots", 1, "--workers", 1)
    assert (code, (tmp_path / "out" / name).read_text()) == (2, "mine")
    assert said == f"error: --out {tmp_path}/out/{name}: cannot be written: File exists, expected a folder\n"


def test_too_few_open_files_to_try_the_policy_are_no_bad_input(soak_test, monkeypatch):
    def crowded(*_, **__):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(subprocess, "run", crowded)
    said = "error: a file, a pipe or a process: Too many open files\n"
    assert soak_test("--hours", 0.001, "--robots", 1) == (LACKING, "", said)


def linked(out, name):
    """Link from the place of a folder in `out` to one of somebody else's, with a bundle, a report, a checkpoint."""
    theirs = out.parent / "theirs"
    files = {theirs / "b" / "bundle.json", theirs / "events" / "b" / "bundle.json", theirs / NAME.format(0)}
    files |= {theirs / each for each in ("report.json", *command.EXTRA_FILES, Path(TENSORBOARD).name)}
    for path in (*files, out / name):
        path.parent.mkdir(parents=True, exist_ok=True)
    for path in files:
        path.write_text("theirs")
    (out / name).symlink_to(theirs)
    return files


@pytest.mark.parametrize("name", command.FOLDERS)
def test_a_link_in_the_place_of_a_folder_is_exit_2(soak_test, tmp_path, name):
    files = linked(tmp_path / "out", name)
    code, _, said = soak_test("--hours", 0.001, "--robots", 1, "--workers", 1)
    assert (code, said) == (
        2,
        f"error: --out {tmp_path}/out/{name}: found a link, expected no link\n",
    )
    assert {path.read_text() for path in files} == {"theirs"}
    assert {path for path in (tmp_path / "theirs").rglob("*") if path.is_file()} == files


@pytest.mark.parametrize("interrupted", [False, True])
@pytest.mark.parametrize("name", command.FOLDERS)
def test_behind_a_link_made_during_the_soak_nothing_changes(tmp_path, name, interrupted):
    files, told = linked(tmp_path / "out", name), report()
    told = told.model_copy(update={"run": told.run.model_copy(update={"interrupted": interrupted})})
    with pytest.raises(OutputError, match=f"{name}: found a link"):
        command._write(told, dict.fromkeys(command.EXTRA_FILES, b""), tmp_path / "out", None)
    assert {path.read_text() for path in files} == {"theirs"}
    delete_report(tmp_path / "out" / name, command.EXTRA_FILES)
    delete_report((tmp_path / "out" / name).parent, command.EXTRA_FILES)
    assert {path.read_text() for path in files} == {"theirs"}


def test_the_folder_itself_may_be_a_link(tmp_path):
    (tmp_path / "large disk").mkdir()
    (tmp_path / "out").symlink_to("large disk")
    command._write(report(), {}, tmp_path / "out", None)
    assert (tmp_path / "large disk" / "report.json").exists()


@pytest.mark.slow
def test_report_that_cannot_be_written_is_exit_1(soak_test, tmp_path, monkeypatch):
    """The disk fills up after the last checkpoint."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill(*arguments, run=run_soak):
        shards = run(*arguments)
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, before[1]))
        return shards

    monkeypatch.setattr(command, "run_soak", fill)
    try:
        code, _, said = soak_test("--hours", 0.0003, "--robots", 1, "--workers", 1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert code == 1
    assert f"error: not kept: --out {tmp_path / 'out'}/" in said
    assert (tmp_path / "out" / "unfinished" / "shard-0000.npz").exists()


def test_folder_of_a_running_soak_is_refused(soak_test, tmp_path):
    out = tmp_path / "out"
    check_report_folder(out)
    with locked(out):
        expected = f"error: {in_use(out)}\n"
        assert soak_test("--hours", 0.001, "--robots", 1, "--workers", 1) == (2, "", expected)
        assert {path.name for path in out.iterdir()} == {LOCK}
