"""Whether results depend on who lived through a soak, and on whether it was cut short: they must not, in any bit."""

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

from deploy.policy.policy import Policy
from eval.bench.stages import SEED
from eval.shard.job import WIDTH
from eval.shard.results import ShardResult
from eval.soak.configuration import SoakConfig
from eval.soak.workers import run_soak
from eval.statistics.budget import BUDGET
from robots.spec import RobotSpec

CREWS = (1, 2, 4)
ROBOTS, HOURS = 4 * WIDTH, 20 / 3600


def same(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Soak the same robots with 1, 2 and 4 workers, then cut short by Ctrl-C half-way and taken up again."""
    with tempfile.TemporaryDirectory() as folder:
        lived, spent = {}, 0.0
        for workers in CREWS:
            began = time.monotonic()
            lived[f"{workers} worker{'s' * (workers > 1)}"] = _soak(
                spec, policy, workers, Path(folder, str(workers))
            )
            spent = time.monotonic() - began
        cut = Path(folder, "cut")
        clock = threading.Timer(spent / 2, os.kill, (os.getpid(), signal.SIGINT))
        clock.start()
        begun = _soak(spec, policy, CREWS[-1], cut)
        clock.cancel()
        lived["cut short and taken up"] = _soak(spec, policy, CREWS[-1], cut)
    (first, expected), *others = lived.items()
    for name, found in others:
        wrong = sorted(differences(expected, found))
        told = f"other {', '.join(wrong)}" if wrong else "the same results, bit for bit"
        console.print(f"{name} against {first}: {told}")
    ticks = sum(int(shard.counts.ticks.sum()) for shard in begun)
    console.print(
        f"it was cut short after {100 * ticks * spec.dt / 3600 / ROBOTS / HOURS:.0f} % of its ticks"
    )


def _soak(spec: RobotSpec, policy: Path, workers: int, folder: Path) -> list[ShardResult]:
    soak = SoakConfig(
        spec=spec,
        policy=Policy.load(policy, spec),
        policy_path=policy,
        budget=BUDGET,
        hours=HOURS,
        robots=ROBOTS,
        seed=SEED,
        workers=workers,
    )
    return run_soak(soak, folder, Console(quiet=True))


def differences(a: Any, b: Any, name: str = "shard") -> set[str]:
    """Names of the arrays and values in which two results differ; NaN is the same as NaN."""
    if isinstance(a, list):
        pairs = [(f"{name} {place}", x, y) for place, (x, y) in enumerate(zip(a, b, strict=True))]
    elif is_dataclass(a):
        pairs = [
            (f"{name} {field.name}", getattr(a, field.name), getattr(b, field.name)) for field in fields(a)
        ]
    else:
        alike = np.array_equal(a, b, equal_nan=isinstance(a, np.ndarray) and a.dtype.kind == "f")
        return set() if alike else {name}
    return set().union(*(differences(x, y, of) for of, x, y in pairs))
