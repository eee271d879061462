"""Compilation of a robot model of unknown origin in a separate process, with bounds of time and memory: it may crash.

python -P -m robots.models.sandbox MODEL FOLDER CPU_S
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

from robots.child_process import GRACE_S, Lifeline, check_not_crowded, end_with
from robots.errors import RobotError
from robots.models.files import referenced_files
from robots.models.mujoco_model import check_size, compile_model, open_model
from robots.resource_limits import limit_process

CPU_S, MEMORY_GIB = 30, 4
"""Bounds of the separate process. Compiling meshes takes six times the memory of the result."""
WALL_FACTOR = 6
"""Wall time allowed, as a multiple of CPU time: the machine may have other work."""
REFUSED = 2
"""Exit code for bad input."""
PASSED = b"passed"
"""Last words of a child that has compiled a model: an exit code alone may be lost."""


def check_compiles(model: Path, folder: Path, *, cpu_s: int = CPU_S) -> None:
    """Check that MuJoCo can compile MJCF or URDF, whose files are in `folder`, within `cpu_s` s of a core.

    Raises:
        RobotError: with MuJoCo's message if it cannot; or it takes too long, too much memory, or crashes; or the result
            needs more memory than `SIZE_MIB`.
        OSError: the computer lacks a process, open files or memory for it.
    """
    referenced_files(model, folder)
    arguments = str(model.resolve()), str(folder.resolve()), str(cpu_s)
    bounds = f"{model}: MuJoCo cannot compile it within {cpu_s} s of a core and {MEMORY_GIB} GiB"
    # -P: imports nothing from the current folder.
    child = [sys.executable, "-P", "-m", "robots.models.sandbox", *arguments]
    with Lifeline() as lifeline:
        end, limit_s = lifeline.end.fileno(), WALL_FACTOR * cpu_s + GRACE_S
        try:
            done = subprocess.run(child, stdin=end, capture_output=True, check=False, timeout=limit_s)
        except subprocess.TimeoutExpired as e:
            raise RobotError(f"{bounds}: not finished after {limit_s:g} s") from e
    check_not_crowded(done.returncode)
    last = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]  # after MuJoCo's warnings
    if done.returncode == REFUSED:
        raise RobotError(last.replace(arguments[0], str(model)))
    if done.returncode or not done.stdout.endswith(PASSED):
        raise RobotError(f"{bounds}: exit code {done.returncode}{last and f': {last:.200}'}")


def _main(model: str, folder: str, cpu_s: str) -> int:
    end_with(sys.stdin.fileno())
    signal.alarm(WALL_FACTOR * int(cpu_s))
    limit_process(int(cpu_s), MEMORY_GIB)
    try:
        check_size(compile_model(open_model(Path(model), Path(folder)), Path(model)), Path(model))
    except RobotError as e:
        print(e, file=sys.stderr)
        return REFUSED
    os.write(sys.stdout.fileno(), PASSED)
    return 0


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
