"""Operating-system signals that end a command: from the keyboard, a terminal that closes, other processes, timers."""

import signal
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from multiprocessing.resource_tracker import ensure_running
from threading import Timer, get_ident
from types import CodeType, FrameType
from typing import Any

UNSTOPPABLE = ("SIGKILL", "SIGSTOP")
"""Signals that no process can handle."""
FAULTS = ("SIGABRT", "SIGBUS", "SIGEMT", "SIGFPE", "SIGILL", "SIGSEGV", "SIGSYS", "SIGTRAP")
"""Faults of this process itself. A handler of Python's would not run before the same instruction has failed again, and
no state can be trusted from which a stop would be planned: the process ends, and drives without commands stop."""
WRITE_ERRORS = ("SIGPIPE", "SIGXFSZ")
"""Ignored by Python, which raises them as errors of the write that failed: no reader and no disk stops a robot."""
HARMLESS = ("SIGCHLD", "SIGCONT", "SIGINFO", "SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGURG", "SIGWINCH")
"""Signals that by default are ignored, or suspend a process."""


NOHUP = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
"""This process was started to go on when its terminal closes."""


def _ending_signals() -> tuple[int, ...]:
    others = (*UNSTOPPABLE, *FAULTS, *WRITE_ERRORS, *HARMLESS, *(["SIGHUP"] if NOHUP else []))
    numbers = {getattr(signal, name) for name in others if hasattr(signal, name)}
    return tuple(sorted(signal.valid_signals() - numbers))


SIGNALS = _ending_signals()
"""All others: by default they end a process. Ctrl-C ends it even where a shell ignores it, in the background."""
AGAIN_S = 0.01
"""s after which a KeyboardInterrupt that Python dropped is raised again."""
REQUESTS = (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1)
"""Those by which service managers, terminals that close, their keys and schedulers of jobs ask a process to end."""


@contextmanager
def handled(handler: Any, numbers: Iterable[int] = SIGNALS) -> Iterator[None]:
    """Send signals of these numbers to `handler`, as `signal.signal` takes it, until the block ends.

    Those that a library handles, not in Python, are left to it.
    """
    ours = [number for number in numbers if signal.getsignal(number) is not None]
    before = [(number, signal.signal(number, handler)) for number in ours]
    try:
        yield
    finally:
        for number, former in before:
            signal.signal(number, former)


@contextmanager
def held_back() -> Iterator[None]:
    """Hold signals back until the block ends; processes that start in it do so until they `ignore_signals`.

    Other threads of this process may receive them: those signals are noted, and raised again at the end.
    """
    noted: list[int] = []
    with handled(lambda number, _: noted.append(number)):
        former = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, former)
    for number in noted:
        signal.raise_signal(number)


@contextmanager
def starting_workers() -> Iterator[None]:
    """Hold signals back while the block starts workers; only this process handles them."""
    with held_back():
        ensure_running()  # the tracker of multiprocessing; its start unblocks some signals
    with held_back():
        yield


@contextmanager
def not_dropped() -> Iterator[None]:
    """Raise the KeyboardInterrupt of a signal that a library drops in the block, or makes another error of."""
    noted: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        noted.append(number)
        raise KeyboardInterrupt

    raising = (signal.default_int_handler, interrupt)
    try:
        with handled(note, [number for number in SIGNALS if signal.getsignal(number) in raising]):
            yield
    except Exception:
        if not noted:
            raise
    if noted:
        raise KeyboardInterrupt


def ignore_signals() -> None:
    """Ignore signals from now on, in a worker, with those that were held back since its start."""
    for number in SIGNALS:
        if signal.getsignal(number) is not None:
            signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def interrupt(_number: int, _frame: FrameType | None) -> None:
    """Handle any signal as Ctrl-C.

    Raises:
        KeyboardInterrupt: always.
    """
    raise KeyboardInterrupt


@contextmanager
def raised_again() -> Iterator[None]:
    """Raise each KeyboardInterrupt that Python drops, as in a destructor, once more, until the block ends."""
    former, timers, main = sys.unraisablehook, list[Timer](), get_ident()

    def hook(dropped: "sys.UnraisableHookArgs") -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            former(dropped)
            return
        number = signal.SIGINT if callable(signal.getsignal(signal.SIGINT)) else signal.SIGTERM
        timers.append(Timer(AGAIN_S, again, (number,)))
        timers[-1].daemon = True
        timers[-1].start()

    def again(number: int) -> None:
        while _is_in(hook.__code__, main):  # what the hook raises is dropped, too
            time.sleep(AGAIN_S)
        signal.pthread_kill(main, number)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = former
        for timer in timers:
            timer.cancel()


def _is_in(code: CodeType, thread: int) -> bool:
    """Return whether a thread is in a function of that code, or in what it has called."""
    frame = sys._current_frames().get(thread)
    while frame is not None and frame.f_code is not code:
        frame = frame.f_back
    return frame is not None


class Interrupts:
    """Signal handler of a run.

    Before it begins, any signal raises KeyboardInterrupt. Then signals are counted and left to the tick: a service
    manager, a closing terminal or a timer may send several. While a robot may have power, the second Ctrl-C and each
    later one raise KeyboardInterrupt, since Python drops some; after that none does, so that files are completed.

    Attributes:
        running: set when a run begins. powered: the robot may have power. count: number of signals.
    """

    def __init__(self) -> None:
        self.running, self.powered, self.count, self._ctrl_c = False, False, 0, 0

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal."""
        self.count += 1
        self._ctrl_c += number == signal.SIGINT
        cuts = self.powered and number == signal.SIGINT and self._ctrl_c >= 2
        if cuts or not self.running:
            raise KeyboardInterrupt
