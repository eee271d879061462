"""Time and memory limits for importing a policy of unknown origin, whose cost is unknown before it runs."""

import os
import resource
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path

from deploy.command_line import BAD_INPUT
from robots.errors import ContractError
from robots.resource_limits import limit_resource

IMPORT_S, MEMORY_GIB = 600.0, 8


@contextmanager
def limit_import(policy: Path) -> Iterator[None]:
    """Limit a block's memory, and end the process with a message if the block takes longer than `IMPORT_S`.

    On systems that cannot limit the memory of a process, such as macOS, only the time is limited.

    Raises:
        ContractError: the block needs more than `MEMORY_GIB`.
        MemoryError: it needs more than the process was allowed before, which is less.
    """
    before, allowed = resource.getrlimit(resource.RLIMIT_DATA), _allowed_gib()
    watchdog = threading.Timer(IMPORT_S, _abort, [policy])
    watchdog.daemon = True
    watchdog.start()
    try:
        limit_resource(resource.RLIMIT_DATA, MEMORY_GIB << 30)
        yield
    except MemoryError as e:
        if allowed < MEMORY_GIB:
            raise
        raise ContractError(f"{policy}: needs more memory than {MEMORY_GIB} GiB") from e
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
        watchdog.cancel()


def _allowed_gib() -> float:
    """Return the memory that this process may use at most, GiB; infinite without a limit."""
    limits = (resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_DATA, resource.RLIMIT_AS))
    return min((most / (1 << 30) for most in limits if most != resource.RLIM_INFINITY), default=inf)


def _abort(policy: Path) -> None:
    """Exit from the watchdog thread: the main thread may be inside the policy."""
    print(f"error: {policy}: not finished after {IMPORT_S:g} s", file=sys.stderr, flush=True)
    os._exit(BAD_INPUT)
