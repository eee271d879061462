"""Bounds of time and memory for files of unknown origin.

A model is compiled in a separate process, which may crash: python -P -m robots.models.sandbox MODEL FOLDER CPU_S
A policy is imported in this process.
"""

import os
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from robots.errors import ContractError, RobotError
from robots.models.files import referenced_files
from robots.models.mujoco_model import compile_model, open_model

CPU_S, MEMORY_GIB = 30, 8
IMPORT_S = 600.0
"""Wall time allowed for importing a policy."""
WALL_FACTOR = 6
"""Wall time allowed, as a multiple of CPU time: the machine may have other work."""
REFUSED = 2
"""Exit code for bad input."""


def check_compiles(model: Path, folder: Path, *, cpu_s: int = CPU_S) -> None:
    """Check that MuJoCo can compile MJCF or URDF, whose files are in `folder`, within `cpu_s` s of a core.

    Raises:
        RobotError: with MuJoCo's message if it cannot; or it takes too long, too much memory, or crashes.
    """
    referenced_files(model, folder)
    arguments = str(model.resolve()), str(folder.resolve()), str(cpu_s)
    bounds = f"{model}: MuJoCo cannot compile it within {cpu_s} s of a core and {MEMORY_GIB} GiB"
    # -P: imports nothing from the current folder.
    child = [sys.executable, "-P", "-m", "robots.models.sandbox", *arguments]
    try:
        done = subprocess.run(child, capture_output=True, text=True, check=False)
    except OSError as e:
        raise RobotError(f"{model}: no process to compile it in: {e.strerror}") from e
    if done.returncode == REFUSED:
        raise RobotError(done.stderr.strip().replace(arguments[0], str(model)))
    if done.returncode:
        last = done.stderr.strip().rpartition("\n")[2]
        raise RobotError(f"{bounds}: exit code {done.returncode}{last and f': {last:.200}'}")


@contextmanager
def limit_import(policy: Path) -> Iterator[None]:
    """Limit a block's memory, and end the process with a message if the block takes longer than `IMPORT_S`.

    On systems that cannot limit the memory of a process, such as macOS, only the time is limited.

    Raises:
        ContractError: the block needs more than `MEMORY_GIB`.
    """
    before = resource.getrlimit(resource.RLIMIT_DATA)
    watchdog = threading.Timer(IMPORT_S, _abort, [policy])
    watchdog.daemon = True
    watchdog.start()
    try:
        _limit(resource.RLIMIT_DATA, MEMORY_GIB << 30)
        yield
    except MemoryError as e:
        raise ContractError(f"{policy}: needs more memory than {MEMORY_GIB} GiB") from e
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
        watchdog.cancel()


def _abort(policy: Path) -> None:
    """Exit from the watchdog thread: the main thread may be inside the policy."""
    print(f"error: {policy}: not finished after {IMPORT_S:g} s", file=sys.stderr, flush=True)
    os._exit(REFUSED)


def _limit(kind: int, most: int) -> None:
    """Limit a resource (`RLIMIT_DATA` or the like) of this process to `most`, or to its lower present limit."""
    soft, hard = resource.getrlimit(kind)
    lowest = min(limit for limit in (most, soft, hard) if limit != resource.RLIM_INFINITY)
    resource.setrlimit(kind, (lowest, hard))


def _main(model: str, folder: str, cpu_s: str) -> int:
    signal.alarm(WALL_FACTOR * int(cpu_s))  # even if the parent is gone
    _limit(resource.RLIMIT_CPU, int(cpu_s))
    _limit(resource.RLIMIT_DATA, MEMORY_GIB << 30)
    _limit(resource.RLIMIT_CORE, 0)
    try:
        compile_model(open_model(Path(model), Path(folder)), Path(model))
    except RobotError as e:
        print(e, file=sys.stderr)
        return REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
