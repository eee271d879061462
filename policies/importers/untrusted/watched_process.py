"""Command in a child process with a time limit, which its parent ends.

Native code that a policy keeps busy can hold Python's lock: then neither a thread nor a signal handler runs in it.
"""

import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Sequence

from deploy.operation.interrupts import REQUESTS, handled
from deploy.start import BAD_INPUT, INTERRUPTED, report_failure
from robots.child_process import Lifeline, check_not_crowded, end_with
from robots.errors import printable
from robots.resource_limits import limit_resource

WALL_S, GRACE_S, POLL_S = 600.0, 5.0, 0.02
"""Time limit of an import; time to remove unfinished files; time between looks at the child."""


def run_watched(command: Callable[[], None], wall_s: float = WALL_S) -> None:
    """Run a command in a fork of this process, which has no threads yet, and exit with its exit code.

    Ctrl-C and requests to end reach the child as a request to end; after `GRACE_S` s it is killed. A command that takes
    longer than `wall_s` s, or that crashes, is reported in one line as bad input.

    Raises:
        SystemExit: in this process, always.
    """
    try:
        _run(command, wall_s)
    except OSError as e:  # of a fork, or of a child without a thread: the computer lacks something
        raise SystemExit(report_failure(e)) from e


def _run(command: Callable[[], None], wall_s: float) -> None:
    requests = {signal.SIGINT, *REQUESTS}
    signal.pthread_sigmask(signal.SIG_BLOCK, requests)  # until each process has its handlers
    lifeline = Lifeline()
    if child := os.fork():
        raise SystemExit(_watch(child, wall_s))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, requests)
    lifeline.cut()  # here only: the parent holds it
    end_with(lifeline.end)
    # For native code whose parent is killed: no thread runs beside it.
    limit_resource(resource.RLIMIT_CPU, int(WALL_S) * (os.cpu_count() or 1))
    limit_resource(resource.RLIMIT_CORE, 0)
    command()


def _watch(child: int, wall_s: float) -> int:
    """Return the exit code of this process."""
    asked: list[int] = []
    numbers = [each for each in (signal.SIGINT, *REQUESTS) if signal.getsignal(each) is not signal.SIG_IGN]
    with handled(lambda number, _: asked.append(number), numbers):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, *REQUESTS})
        code = _wait(child, wall_s, asked)
        if code is None:
            _end(child)
    if asked:
        return INTERRUPTED
    if code is None:
        return _refuse(f"not finished after {wall_s:g} s")
    check_not_crowded(code)
    return code if code >= 0 else _refuse(f"ended by the system: {signal.strsignal(-code)}")


def _wait(child: int, seconds: float, asked: Sequence[int] = ()) -> int | None:
    """Return the child's exit code, or None if it goes on after this time or until this process is asked to end."""
    until = time.monotonic() + seconds
    while not asked and time.monotonic() < until:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(POLL_S)
    return None


def _end(child: int) -> None:
    os.kill(child, signal.SIGTERM)
    if _wait(child, GRACE_S) is None:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def _refuse(why: str) -> int:
    print(f"error: {printable(' '.join(sys.argv[1:]))}: {why}", file=sys.stderr)
    return BAD_INPUT
