"""Job of a shard: everything that decides its results, with the fingerprint of code, libraries and processor."""

import hashlib
import os
import platform
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import deploy
import eval as judged
import robots
from deploy.plugins import TASKS, installed
from eval.faults.schedule import FaultSettings
from robots.errors import ConfigError

WIDTH = 16
"""Robots in a shard, of which the last shard may count fewer. Wide enough to share costs, narrow enough that 32
robots keep two cores busy."""
ARM_S = 0.2
"""s after which robots are armed for the first time: estimators need samples first."""
POLL_S = 1.0
"""s between two checks of progress, interruption and latched robots."""
OPERATOR_S = 60.0
"""s that a latched robot waits until the operator arms it again."""
LIBRARIES = ("mujoco", "pin", "ruckig", "filterpy", "onnxruntime", "numpy", "scipy", "numba", "llvmlite")
PACKAGES = (robots, deploy, judged)

_version = cache(version)


def versions() -> dict[str, str]:
    """Return the versions of Python and of the libraries, by name."""
    return {"python": platform.python_version(), **{name: _version(name) for name in LIBRARIES}}


def code_digest() -> str:
    """SHA-256 of the names and texts of every module that a soak runs, installed tasks of other packages included."""
    own = [(package.__name__, path) for package in PACKAGES for path in package.__path__]
    tasks = {entry.module.partition(".")[0] for entry in installed(TASKS).values()}
    return _digest((*own, *(source for name in sorted(tasks - {"deploy"}) for source in _sources(name))))


def _sources(name: str) -> Iterator[tuple[str, str]]:
    """Yield name and place of a top-level package or module, without importing it."""
    found = find_spec(name)
    if found is None or found.origin is None:
        raise ConfigError(f"{TASKS}: {name}: not found")
    yield from ((name, place) for place in found.submodule_search_locations or [found.origin])


@cache
def _digest(sources: tuple[tuple[str, str], ...]) -> str:
    digest = hashlib.sha256()
    for name, place in sources:
        folder = Path(place)
        for file in sorted(folder.rglob("*.py")) if os.path.isdir(folder) else [folder]:
            text = file.read_bytes()
            digest.update(f"{name}/{file.relative_to(folder).as_posix()} {len(text)}\n".encode())
            digest.update(text)
    return digest.hexdigest()


def processor() -> str:
    """Return the processor's name: libraries choose instructions by it, and round differently with others."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardJob:
    """One shard's job: robot, policy, seed, ticks, faults.

    Attributes:
        robot: folder. policy: file. robot_digest, policy_digest: SHA-256 of both when the soak began.
        draws_digest, limits_digest: likewise of draws.toml and limits.toml; None: not compared.
        seed: of the soak.
        first: index of the shard's first robot. robots: number of its robots that count.
        ticks: control ticks to simulate. sample_ticks: ticks between two samples.
        faults: settings of fault injection; None for no faults.
        operator_s: until a robot without power is armed again; None for that of the faults, else `OPERATOR_S`.
        code_digest: SHA-256 of the code when the job was made.
    """

    robot: Path
    policy: Path
    robot_digest: str
    policy_digest: str
    seed: int
    first: int
    robots: int
    ticks: int
    sample_ticks: int
    faults: FaultSettings | None = None
    operator_s: float | None = None
    draws_digest: str | None = None
    limits_digest: str | None = None
    code_digest: str = field(default_factory=code_digest)
