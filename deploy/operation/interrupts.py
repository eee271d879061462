"""Operating-system signals that end a command: Ctrl-C, termination, a lost terminal."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import numpy as np

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
ECHO_S = 0.5
"""Wall time after the first signal in which another one is taken for its echo, unless it is a Ctrl-C."""


@contextmanager
def handled(handler: Any) -> Iterator[None]:
    """Send all `SIGNALS` to `handler`, as `signal.signal` takes it, until the block ends."""
    before = [(number, signal.signal(number, handler)) for number in SIGNALS]
    try:
        yield
    finally:
        for number, former in before:
            signal.signal(number, former)


class Interrupts:
    """Signal handler: the first signal is counted and left to the tick, a later one raises KeyboardInterrupt.

    A terminal that closes may send two signals in the same millisecond: these count as one.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.count, self.now, self._first, self._raised = 0, now, np.inf, False

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal."""
        self.count += 1
        self._first = min(self._first, self.now())
        repeated = self.count > 1 and (number == signal.SIGINT or self.now() > self._first + ECHO_S)
        if repeated and not self._raised:
            self._raised = True
            raise KeyboardInterrupt
