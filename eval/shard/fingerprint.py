"""Fingerprint of the code and libraries that decide the results of a soak: with the same seed, the same results."""

import hashlib
import platform
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import deploy
import eval as judged
import robots
from deploy.plugins import TASKS, installed
from robots.errors import ConfigError

LIBRARIES = ("mujoco", "pin", "ruckig", "filterpy", "onnxruntime", "numpy", "scipy")
PACKAGES = (robots, deploy, judged)


def versions() -> dict[str, str]:
    """Return the versions of Python and of the libraries, by name."""
    return {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}


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
        for file in sorted(folder.rglob("*.py")) if folder.is_dir() else [folder]:
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
