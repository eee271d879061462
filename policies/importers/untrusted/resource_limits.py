"""Time and memory limits for importing an untrusted policy, whose cost is unknown before it runs."""

import os
import resource
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deploy.command_line import BAD_INPUT
from robots.errors import ContractError
from robots.models.sandbox import limit_resource

SECONDS_MAX = 600.0
MEMORY_BYTES_MAX = 8 << 30


@contextmanager
def limit_resources(path: Path) -> Iterator[None]:
    """Limit a block's memory, and end the process with a message if the block takes longer than `SECONDS_MAX`.

    On systems that cannot limit the memory of a process, such as macOS, only the time is limited.

    Raises:
        ContractError: the block needs more than `MEMORY_BYTES_MAX`.
    """
    before = resource.getrlimit(resource.RLIMIT_DATA)
    watchdog = threading.Timer(SECONDS_MAX, _abort, [path])
    watchdog.daemon = True
    watchdog.start()
    try:
        limit_resource(resource.RLIMIT_DATA, MEMORY_BYTES_MAX)
        yield
    except MemoryError as e:
        raise ContractError(f"{path}: needs more memory than {MEMORY_BYTES_MAX} bytes") from e
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
        watchdog.cancel()


def _abort(path: Path) -> None:
    """Exit from the watchdog thread: the main thread may be inside the policy."""
    print(f"error: {path}: not finished after {SECONDS_MAX:g} s", file=sys.stderr, flush=True)
    os._exit(BAD_INPUT)
