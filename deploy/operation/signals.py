"""What ends a command from outside: Ctrl-C, termination, a lost terminal."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def handled(handler: Any) -> Iterator[None]:
    """All of them go to `handler`, as `signal.signal` takes it, for a while."""
    before = [(which, signal.signal(which, handler)) for which in SIGNALS]
    try:
        yield
    finally:
        for which, former in before:
            signal.signal(which, former)
