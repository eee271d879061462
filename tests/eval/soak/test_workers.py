"""Workers of a soak end with their parent, and with each other."""

import multiprocessing as mp
import os
import signal
import subprocess
import sys
from concurrent.futures import wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress

import pytest
from rich.console import Console

pytest.importorskip("mujoco")

from eval.shard.job import WIDTH
from eval.soak.checkpoint import prepare_folder
from eval.soak.workers import WorkerPool
from support.eval.soaks import soak_config

WAIT_S = 60.0
SCRIPT = """
from concurrent.futures import wait
from eval.soak.cli import cli
from eval.soak.workers import WorkerPool
def report(pool, futures):
    while not all(pool.progress):
        wait(futures, timeout=0.05)
    print("all shards run", flush=True)
    wait(futures)
WorkerPool.show_progress = report
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
            assert soak.communicate(timeout=WAIT_S) == ("", None)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(soak.pid, signal.SIGKILL)


@pytest.mark.slow
def test_other_workers_end_with_one_that_was_killed(arm_policy, tmp_path, monkeypatch):
    """They ignore SIGTERM, by which a pool ends them, and would go on to the end of their shards."""
    soak = soak_config(arm_policy, hours=0.5, robots=2 * WIDTH, workers=2)

    def kill(pool, futures):
        while not all(pool.progress):
            wait(futures, timeout=0.01)
        os.kill(mp.active_children()[0].pid, signal.SIGKILL)
        for future in futures:
            future.result()

    monkeypatch.setattr(WorkerPool, "show_progress", kill)
    prepare_folder(tmp_path)
    with pytest.raises(BrokenProcessPool):
        WorkerPool(soak, tmp_path, Console(quiet=True)).run()
    assert not mp.active_children()
    assert not list(tmp_path.glob("*.npz"))
