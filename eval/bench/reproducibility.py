"""Reproducibility: equal bits for any number of workers, and for a soak that is interrupted and resumed."""

import os
import signal
import tempfile
import threading
import time
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from eval.bench.soak_setup import soak_config
from eval.shard.job import WIDTH
from eval.shard.judging import ShardResult
from eval.soak.workers import run_soak
from robots.spec import RobotSpec

WORKERS = (1, 2, 4)
ROBOTS, HOURS = 4 * WIDTH, 20 / 3600


def reproducibility(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Compare soaks with 1, 2 and 4 workers, and one that Ctrl-C interrupts half-way, with each other."""
    with tempfile.TemporaryDirectory() as folder:
        results, spent = {}, 0.0
        for workers in WORKERS:
            began = time.monotonic()
            name = f"{workers} worker{'s' * (workers > 1)}"
            results[name] = _soak(spec, policy, workers, Path(folder, str(workers)))
            spent = time.monotonic() - began
        interrupted = Path(folder, "interrupted")
        partial = _interrupted_soak(spec, policy, interrupted, spent / 2)
        results["interrupted and resumed"] = _soak(spec, policy, WORKERS[-1], interrupted)
    (first, expected), *others = results.items()
    for name, found in others:
        unequal = sorted(differences(expected, found))
        verdict = f"other {', '.join(unequal)}" if unequal else "the same results, bit for bit"
        console.print(f"{name} against {first}: {verdict}")
    ticks = sum(int(shard.counts.ticks.sum()) for shard in partial)
    console.print(f"interrupted after {100 * ticks * spec.dt / 3600 / ROBOTS / HOURS:.0f} % of the ticks")


def _soak(spec: RobotSpec, policy: Path, workers: int, folder: Path) -> list[ShardResult]:
    soak = soak_config(spec, policy, hours=HOURS, robots=ROBOTS, workers=workers)
    return run_soak(soak, folder, Console(quiet=True))


def _interrupted_soak(spec: RobotSpec, policy: Path, folder: Path, seconds: float) -> list[ShardResult]:
    timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    partial = _soak(spec, policy, WORKERS[-1], folder)
    timer.cancel()
    return partial


def differences(a: Any, b: Any, name: str = "shard") -> set[str]:
    """Return the names of arrays and values in which two results differ; NaN equals NaN."""
    if isinstance(a, list):
        pairs = [(f"{name} {place}", x, y) for place, (x, y) in enumerate(zip(a, b, strict=True))]
    elif is_dataclass(a):
        names = [field.name for field in fields(a)]
        pairs = [(f"{name} {field}", getattr(a, field), getattr(b, field)) for field in names]
    else:
        alike = np.array_equal(a, b, equal_nan=isinstance(a, np.ndarray) and a.dtype.kind == "f")
        return set() if alike else {name}
    return set().union(*(differences(x, y, part) for part, x, y in pairs))
