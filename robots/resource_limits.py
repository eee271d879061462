"""Limits of time and memory of a process."""

import resource


def limit_resource(kind: int, most: int) -> None:
    """Limit a resource (`RLIMIT_DATA` or the like) of this process to `most`, or to its lower present limit."""
    soft, hard = resource.getrlimit(kind)
    lowest = min(limit for limit in (most, soft, hard) if limit != resource.RLIM_INFINITY)
    resource.setrlimit(kind, (lowest, hard))


def limit_process(cpu_s: int, memory_gib: int) -> None:
    """Limit the time on a core and the memory of this process, and leave no core dump if it exceeds them."""
    limit_resource(resource.RLIMIT_CPU, cpu_s)
    limit_resource(resource.RLIMIT_DATA, memory_gib << 30)
    limit_resource(resource.RLIMIT_CORE, 0)
