"""Time and memory limits for importing a policy of unknown origin, whose cost is unknown before it runs."""

import os
import resource
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
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
    """
    before = resource.getrlimit(resource.RLIMIT_DATA)
    watchdog = threading.Timer(IMPORT_S, _abort, [policy])
    watchdog.daemon = True
    watchdog.start()
    try:
        limit_resource(resource.RLIMIT_DATA, MEMORY_GIB << 30)
        yield
    except MemoryError as e:
        raise ContractError(f"{policy}: needs more memory than {MEMORY_GIB} GiB") from e
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
        watchdog.cancel()


def _abort(policy: Path) -> None:
    """Exit from the watchdog thread: the main thread may be inside the policy."""
    print(f"error: {policy}: not finished after {IMPORT_S:g} s", file=sys.stderr, flush=True)
    os._exit(BAD_INPUT)
