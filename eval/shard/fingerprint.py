"""On what the results of a soak depend: two runs with the same identity and seed are the same run."""

import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

import deploy
import eval as judged
import robots

LIBRARIES = ("mujoco", "pin", "ruckig", "filterpy", "onnxruntime", "numpy", "scipy")
PACKAGES = (robots, deploy, judged)


def versions() -> dict[str, str]:
    """Of Python and of the libraries, by name."""
    return {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}


@cache
def code_digest() -> str:
    """SHA-256 of the names and texts of every module that a soak runs."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        (folder,) = map(Path, package.__path__)
        for file in sorted(folder.rglob("*.py")):
            text = file.read_bytes()
            digest.update(f"{package.__name__}/{file.relative_to(folder).as_posix()} {len(text)}\n".encode())
            digest.update(text)
    return digest.hexdigest()


def processor() -> str:
    """Its name: libraries choose their instructions by it, and round differently with others."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())
