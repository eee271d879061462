"""A stranger's model is compiled in a process of its own first, which has bounds, and may crash.

python -P -m robots.models.quarantine MODEL FOLDER CPU_S
"""

import resource
import signal
import subprocess
import sys
from pathlib import Path

from robots.errors import RobotError
from robots.models.files import named_files
from robots.models.mujoco_model import compile_model, open_model

CPU_S, MEMORY_GIB = 30, 8
WAITED = 6
"""Times that long it may take by the clock, on a machine that has other work."""
REFUSED = 2


def check_compiles(model: Path, folder: Path, *, cpu_s: int = CPU_S) -> None:
    """See that MuJoCo can compile a model, within bounds.

    Args:
        model: MJCF or URDF. folder: that its files must lie in. cpu_s: s of a core.

    Raises:
        RobotError: it cannot, and says why; or it takes too long, too much memory, or crashes.
    """
    named_files(model, folder)
    told = str(model.resolve()), str(folder.resolve()), str(cpu_s)
    bounds = f"{model}: MuJoCo cannot compile it within {cpu_s} s of a core and {MEMORY_GIB} GiB"
    # -P: no code of the folder it is called in.
    child = [sys.executable, "-P", "-m", "robots.models.quarantine", *told]
    try:
        done = subprocess.run(child, capture_output=True, text=True, check=False)
    except OSError as e:
        raise RobotError(f"{model}: no process to compile it in: {e.strerror}") from e
    if done.returncode == REFUSED:
        raise RobotError(done.stderr.strip().replace(told[0], str(model)))
    if done.returncode:
        last = done.stderr.strip().rpartition("\n")[2]
        raise RobotError(f"{bounds}: exit code {done.returncode}{last and f': {last:.200}'}")


def bound(kind: int, most: int) -> None:
    """Let this process take no more of a resource than `most`, or than it may already: of `RLIMIT_DATA` or the like."""
    soft, hard = resource.getrlimit(kind)
    lowest = min(limit for limit in (most, soft, hard) if limit != resource.RLIM_INFINITY)
    resource.setrlimit(kind, (lowest, hard))


def _main(model: str, folder: str, cpu_s: str) -> int:
    signal.alarm(WAITED * int(cpu_s))  # whether or not somebody still waits
    bound(resource.RLIMIT_CPU, int(cpu_s))
    bound(resource.RLIMIT_DATA, MEMORY_GIB << 30)
    bound(resource.RLIMIT_CORE, 0)
    try:
        compile_model(open_model(Path(model), Path(folder)), Path(model))
    except RobotError as e:
        print(e, file=sys.stderr)
        return REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
