"""Trainings that cannot be written to the end: work is lost, said in one line."""

import errno
import os
import re
import resource
import shutil
import threading
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("av")

from policies.training.checkpoint import save_checkpoint
from policies.training.cli import _check_finite
from policies.training.cli import cli as policy_train
from policies.training.envs import RuntimeEnv
from policies.training.recipe import find_recipe
from robots.errors import ConfigError

pytestmark = pytest.mark.slow


@pytest.fixture
def train(call, tmp_path, monkeypatch):
    """A training of two stages with four robots: exit code, standard output and standard error."""
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)  # a training that fails leaves its own
    head, _, _ = find_recipe("arm").read_text(encoding="utf-8").partition("[[learner.stages]]")
    for name, value in {"robots": 4, "goals_per_episode": 1, "num_steps_per_env": 8}.items():
        head = re.sub(f"{name} = .*", f"{name} = {value}", head)
    stage = "[[learner.stages]]\niterations = 2\nlearning_rate = 1e-3\n"
    (tmp_path / "tiny.toml").write_text(head + 2 * stage)
    return lambda out: call(policy_train, "--recipe", tmp_path / "tiny.toml", "--out", out)


@contextmanager
def no_file_longer_than(size):
    """As on a disk that is full, for this process."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_nothing_of_a_repository_around_is_kept(train, tmp_path):
    assert train(tmp_path / "out")[0] == 0
    assert (tmp_path / "out" / "arm.pt").exists()
    assert not [*(tmp_path / "out").rglob("*.diff")]


def test_no_room_for_the_state_of_a_training_is_one_line(train, tmp_path):
    out = tmp_path / "out"
    with no_file_longer_than(60_000):
        code, _, complaint = train(out)
    path = out / "model_0.pt"
    said = f"error: not kept: --out {path}: cannot be written: {os.strerror(errno.EFBIG)}\n"
    assert (code, complaint) == (1, said)
    assert not path.exists()  # the next training may use the folder


def test_no_room_for_the_checkpoint_is_one_line(train, tmp_path, monkeypatch):
    def full(*arguments, **options):
        with no_file_longer_than(60_000):
            return save_checkpoint(*arguments, **options)

    monkeypatch.setattr("policies.training.cli.save_checkpoint", full)
    code, _, complaint = train(tmp_path / "out")
    path = tmp_path / "out" / "arm.pt"
    said = f"error: not kept: --out {path}: cannot be written: {os.strerror(errno.EFBIG)}\n"
    assert (code, complaint) == (1, said)
    assert not path.exists()


@pytest.mark.parametrize("step", [1, 31])
def test_a_folder_that_is_deleted_meanwhile_is_one_line(train, tmp_path, monkeypatch, step):
    """In the first stage, and before the last file of the second one."""
    out, steps, count = tmp_path / "out", RuntimeEnv.step, iter(range(1, 10**6))

    def counted(self, actions):
        if next(count) == step:
            shutil.rmtree(out)
        return steps(self, actions)

    monkeypatch.setattr(RuntimeEnv, "step", counted)
    code, _, complaint = train(out)
    assert code == 1
    assert re.fullmatch(
        rf"error: not kept: --out {out}/\S+: cannot be written: No such file or directory\n", complaint
    )


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_weights_that_are_no_numbers_are_named(bad):
    actor = torch.nn.Linear(2, 2)
    runner = SimpleNamespace(alg=SimpleNamespace(actor=actor), current_learning_iteration=7)
    _check_finite(runner)
    with torch.no_grad():
        actor.weight[1, 0] = bad
    with pytest.raises(
        ConfigError, match=r"^learner: weights of the policy are not finite after iteration 7"
    ):
        _check_finite(runner)
