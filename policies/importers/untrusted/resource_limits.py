"""Limits of memory and of a core's time for a policy of unknown origin, whose cost is unknown before it runs."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from math import ceil, inf
from pathlib import Path

from robots.errors import ContractError
from robots.resource_limits import limit_resource

MEMORY_GIB = 8


@contextmanager
def limit_memory(policy: Path) -> Iterator[None]:
    """Limit a block's memory, except on systems that cannot limit the memory of a process, such as macOS.

    Raises:
        ContractError: the block needs more than `MEMORY_GIB`.
        MemoryError: it needs more than the process was allowed before, which is less.
    """
    before, allowed = resource.getrlimit(resource.RLIMIT_DATA), _allowed_gib()
    try:
        limit_resource(resource.RLIMIT_DATA, MEMORY_GIB << 30)
        yield
    except MemoryError as e:
        if allowed < MEMORY_GIB:
            raise
        raise ContractError(f"{policy}: needs more memory than {MEMORY_GIB} GiB") from e
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def _allowed_gib() -> float:
    """Return the memory that this process may use at most, GiB; infinite without a limit."""
    limits = (resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_DATA, resource.RLIMIT_AS))
    return min((most / (1 << 30) for most in limits if most != resource.RLIM_INFINITY), default=inf)


@contextmanager
def limit_cpu(cpu_s: int) -> Iterator[None]:
    """Let the system end this process (SIGXCPU) if a block needs more than `cpu_s` s of a core."""
    before, used = resource.getrlimit(resource.RLIMIT_CPU), resource.getrusage(resource.RUSAGE_SELF)
    limit_resource(resource.RLIMIT_CPU, ceil(used.ru_utime + used.ru_stime) + cpu_s)
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_CPU, before)
