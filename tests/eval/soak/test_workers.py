"""Workers of a soak end with their parent, and with each other."""

import os
import signal
import subprocess
import sys
from contextlib import suppress

import pytest

pytest.importorskip("mujoco")

from eval.shard.job import WIDTH

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
