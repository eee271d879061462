"""Workers of a soak end with their parent, and are replaced where they die by themselves."""

import errno
import multiprocessing as mp
import os
import signal
import subprocess
import sys
from contextlib import nullcontext, suppress
from multiprocessing.context import SpawnProcess

import numpy as np
import pytest
from rich.console import Console

pytest.importorskip("mujoco")

from eval.shard.job import WIDTH
from eval.soak.checkpoint import prepare_folder
from eval.soak.worker_pool import DEATHS, WorkerPool
from robots.child_process import CROWDED
from robots.errors import ContractError
from support.eval.soaks import soak_config

WAIT_S = 60.0
SCRIPT = """
from eval.soak.cli import cli
from eval.soak.worker_pool import WorkerPool
def step(pool, step=WorkerPool.step):
    step(pool)
    if all(pool.progress):
        print("all shards run", flush=True)
WorkerPool.step = step
cli()
"""


@pytest.mark.slow
def test_no_worker_survives_the_soak(arm_policy, tmp_path):
    """Workers hold the writing end of a pipe that ends when none is left; by themselves they would run for hours."""
    options = ("--policy", arm_policy, "--hours", "1", "--robots", str(2 * WIDTH), "--out", tmp_path / "out")
    command = [sys.executable, "-c", SCRIPT, *map(str, options)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as soak:
        try:
            assert "all shards run\n" in iter(soak.stdout.readline, "")
            soak.send_signal(signal.SIGKILL)
            soak.communicate(timeout=WAIT_S)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(soak.pid, signal.SIGKILL)


@pytest.fixture
def pool(arm_policy, tmp_path):
    """Two workers for an hour each, in a soak of two shards; they end with the test."""
    prepare_folder(tmp_path)
    return WorkerPool(
        soak_config(arm_policy, hours=1.0, robots=2 * WIDTH, workers=2), tmp_path, Console(quiet=True)
    )


def exit_crowded(*_):
    raise SystemExit(CROWDED)


def children():
    return {child.pid for child in mp.active_children()}


@pytest.mark.parametrize("victim", [0, 1])
@pytest.mark.slow
def test_killed_worker_is_replaced_while_the_other_goes_on(pool, monkeypatch, victim):
    """Whichever of them: the one that was started last, too."""
    first = []

    def step(pool, step=WorkerPool.step):
        step(pool)
        if not first and all(pool.progress):
            first.extend(sorted(children()))
            os.kill(first[victim], signal.SIGKILL)
        elif first and len(children()) == 2:
            assert children() & {*first} == {first[1 - victim]}
            raise KeyboardInterrupt

    monkeypatch.setattr(WorkerPool, "step", step)
    pool.run()
    assert first
    assert not children()


def test_workers_that_die_again_and_again_end_the_soak(pool, monkeypatch):
    killed = set()

    def step(pool, step=WorkerPool.step):
        step(pool)
        killed.update(children())
        for pid in children():
            os.kill(pid, signal.SIGKILL)

    monkeypatch.setattr("eval.soak.worker_pool.POLL_S", 0.0)
    monkeypatch.setattr(WorkerPool, "step", step)
    with pytest.raises(RuntimeError, match=rf"workers of shard [01] died {DEATHS} times in a row"):
        pool.run()
    assert DEATHS <= len(killed) <= 2 * DEATHS
    assert not children()


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_worker_that_somebody_has_stopped_is_killed_at_the_end(pool, monkeypatch, error):
    """SIGSTOP: it hears of nothing any more."""

    def step(pool, step=WorkerPool.step):
        step(pool)
        stopped.extend(children())
        for pid in stopped:
            os.kill(pid, signal.SIGSTOP)
        raise error

    stopped = []
    monkeypatch.setattr("eval.soak.worker_pool.END_S", 0.0)
    monkeypatch.setattr(WorkerPool, "step", step)
    with pytest.raises(ZeroDivisionError) if error is ZeroDivisionError else nullcontext():
        pool.run()
    assert len(stopped) == 2
    assert not children()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_arrives_while_a_worker_starts_interrupts_the_soak(
    arm_policy, tmp_path, monkeypatch, number
):
    """And leaves none behind."""

    def start(self, start=SpawnProcess.start):
        os.kill(os.getpid(), number)
        start(self)

    monkeypatch.setattr(SpawnProcess, "start", start)
    prepare_folder(tmp_path)
    pool = WorkerPool(soak_config(arm_policy, hours=0.0003, robots=1), tmp_path, Console(quiet=True))
    pool.run()
    assert (pool.pending, pool.stop.value) == ({0}, 1)
    assert not children()


@pytest.mark.slow
def test_error_of_a_worker_is_the_soaks(arm_policy, tmp_path):
    """The policy changes after its digest was taken."""
    policy = tmp_path / "policy.onnx"
    policy.write_bytes(arm_policy.read_bytes())
    soak = soak_config(policy, hours=1.0, robots=1)
    policy.write_bytes(b"")
    with pytest.raises(ContractError, match=r"policy\.onnx: not a valid ONNX model"):
        WorkerPool(soak, tmp_path, Console(quiet=True)).run()


def test_a_worker_without_a_thread_is_a_lack_of_the_computer(pool, monkeypatch):
    monkeypatch.setattr("eval.soak.worker_pool.work", exit_crowded)
    with pytest.raises(BlockingIOError, match=os.strerror(errno.EAGAIN)):
        pool.run()
    assert not children()


@pytest.mark.slow
def test_defect_of_a_worker_ends_the_soak(arm_policy, tmp_path, capfd):
    soak = soak_config(arm_policy, hours=1.0, robots=1)
    prepare_folder(tmp_path)
    soak.checkpoint(0, tmp_path).store({"runtime.ticks": np.zeros(1)})
    with pytest.raises(RuntimeError, match="the worker of shard 0 failed, with exit code 1"):
        WorkerPool(soak, tmp_path, Console(quiet=True)).run()
    assert "KeyError" in capfd.readouterr().err
