"""Child processes that end with their parent, whatever ends it: `kill -9`, a crash, the system short of memory.

A child waits for the end of a pipe whose other end only its parent holds. The kernel closes that with the parent, on
Linux and on macOS, so that no child relies on being told.
"""

import errno
import os
import time
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from threading import Thread
from types import TracebackType
from typing import Self

ENDED = 1
"""Exit code of a child whose parent has gone: nobody is left to read it."""
CROWDED = 75
"""Exit code of a child that the system lets start no thread."""
GRACE_S = 5.0
"""s after the time limit that a child sets itself: one that still runs then, as one that SIGSTOP stopped, is killed."""


class Lifeline:
    """Pipe on which the lives of child processes hang: they end when it is cut, or when this process ends.

    Attributes:
        end: the children's end, given to them as an argument or as their standard input.
    """

    def __init__(self) -> None:
        self.end, self._held = Pipe(duplex=False)

    def cut(self) -> None:
        """End all children that hang on it, at once and without their doing."""
        self._held.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.cut()
        self.end.close()


def end_with(lifeline: "Connection | int", grace_s: float = 0.0) -> None:
    """Let this process end as soon as its lifeline is cut; `lifeline` is the child's end, or its descriptor.

    Call it first: a child whose parent has gone already ends here. What it was writing stays as it was, as after
    `kill -9`, unless it finishes within `grace_s`.

    Raises:
        SystemExit: with `CROWDED`, for `check_not_crowded`.
    """
    try:
        Thread(target=_end_after, args=(lifeline, grace_s), daemon=True).start()
    except RuntimeError as e:  # Python's only one: no further thread can be started
        raise SystemExit(CROWDED) from e


def check_not_crowded(code: int) -> None:
    """Check that a child's exit code is not `CROWDED`.

    Raises:
        BlockingIOError: it is; with the errno EAGAIN.
    """
    if code == CROWDED:
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))


def _end_after(lifeline: "Connection | int", grace_s: float) -> None:
    wait([lifeline])  # nothing is ever sent: what can be read is the end
    time.sleep(grace_s)
    os._exit(ENDED)
