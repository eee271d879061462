"""How much of this machine a foreign policy may take: what runs it cannot know before what it will cost."""

import os
import resource
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deploy.command_line import BAD_INPUT
from robots.errors import ContractError
from robots.models.quarantine import bound

SECONDS_MAX = 600.0
MEMORY_BYTES_MAX = 8 << 30


@contextmanager
def bounded(path: Path) -> Iterator[None]:
    """Ends the process with one line if the block takes too long, and refuses it more memory than that.

    Where the system cannot bound the memory of a process, as macOS, only time is bounded.

    Raises:
        ContractError: the block asked for more memory.
    """
    before = resource.getrlimit(resource.RLIMIT_DATA)
    watchdog = threading.Timer(SECONDS_MAX, _give_up, [path])
    watchdog.daemon = True
    watchdog.start()
    try:
        bound(resource.RLIMIT_DATA, MEMORY_BYTES_MAX)
        yield
    except MemoryError as e:
        raise ContractError(f"{path}: found more than {MEMORY_BYTES_MAX} bytes of memory in use") from e
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
        watchdog.cancel()


def _give_up(path: Path) -> None:
    """From another thread: the one that runs the policy may be deep in it."""
    print(f"error: {path}: found no end after {SECONDS_MAX:g} s", file=sys.stderr, flush=True)
    os._exit(BAD_INPUT)
