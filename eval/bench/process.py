"""Cost of a process: time from the start of deploy-run to its first tick, and growth of a shard's memory."""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console

from eval.bench.soak_setup import shard_job
from eval.shard.job import WIDTH
from eval.shard.shard import Shard
from robots.child_process import Lifeline
from robots.spec import RobotSpec

MINUTES = 10
"""Simulated minutes of the memory bench."""
STARTS = 5
SCRIPT = """
import sys, deploy.runtime as r
from robots.child_process import end_with
end_with(sys.stdin.fileno())
def act(self, action, act=r.Runtime.act):
    act(self, action)
    print(TAG, 'torch' in sys.modules, flush=True)
r.Runtime.act, TAG = act, 'first tick, torch:'
from deploy.operation.cli import cli
cli()
"""
"""deploy-run that prints after every tick whether torch is imported, and ends with the bench."""


def startup(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Print the median time to the first tick, and whether torch was imported."""
    with tempfile.TemporaryDirectory() as out:
        options = ["--robot", str(spec.folder), "--policy", str(policy), "--duration", "1", "--out", out]
        starts = [_first_tick([sys.executable, "-c", SCRIPT, *options]) for _ in range(STARTS)]
    times, torch = zip(*starts, strict=True)
    console.print(
        f"deploy-run: first tick after {np.median(times):.2f} s (median of {STARTS}, at most 3);"
        f" torch imported: {'yes' if any(torch) else 'no'}"
    )


def _first_tick(command: list[str]) -> tuple[float, bool]:
    """Return s from the start of a process to the end of its first tick, and whether torch was imported."""
    began = time.perf_counter()
    with (
        Lifeline() as lifeline,
        subprocess.Popen(command, stdin=lifeline.end.fileno(), stdout=subprocess.PIPE, text=True) as process,
    ):
        for line in process.stdout or ():
            if line.startswith("first tick, torch:"):
                spent = time.perf_counter() - began
                process.kill()
                return spent, line.split()[-1] == "True"
    raise RuntimeError("deploy-run ended without a tick")


def memory(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Print the resident memory of a shard after one and after ten simulated minutes."""
    minute = round(60 / spec.dt)
    sizes: list[int] = []

    def sample(ticks: int) -> None:
        if ticks % minute == 0:
            sizes.append(_resident_kib())

    Shard(shard_job(spec, policy, 60 * MINUTES)).run(sample, lambda: False)
    console.print(
        f"memory of a shard of {WIDTH}: {sizes[0] / 1024:.1f} MiB after 1 simulated minute,"
        f" {sizes[-1] / 1024:.1f} MiB after {len(sizes)}"
    )


def _resident_kib() -> int:
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return pages * resource.getpagesize() // 1024
