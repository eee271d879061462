"""Time from the start of the deploy-run process to its first tick."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console

from robots.spec import RobotSpec

STARTS = 5
SCRIPT = """
import sys, deploy.runtime as r
def act(self, action, act=r.Runtime.act):
    act(self, action)
    print(TAG, 'torch' in sys.modules, flush=True)
r.Runtime.act, TAG = act, 'first tick, torch:'
from deploy.operation.cli import cli
cli()
"""
"""deploy-run that prints after every tick whether torch is imported."""


def start(spec: RobotSpec, policy: Path, console: Console) -> None:
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
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout or ():
            if line.startswith("first tick, torch:"):
                spent = time.perf_counter() - began
                process.kill()
                return spent, line.split()[-1] == "True"
    raise RuntimeError("deploy-run ended without a tick")
