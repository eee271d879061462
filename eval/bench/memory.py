"""Growth of a shard's memory."""

import resource
from pathlib import Path

from rich.console import Console

from eval.bench.soak_setup import shard_job
from eval.shard.job import WIDTH
from eval.shard.shard import Shard
from robots.spec import RobotSpec

MINUTES = 10


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
    """Return the present resident memory in KiB; the peak on systems without /proc."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return pages * resource.getpagesize() // 1024
