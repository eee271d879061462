"""Start of a command line: outputs that may fail, and Ctrl-C during imports, which take a second or more.

Ctrl-C then ends it at once and quietly, without cleaning up: nothing is open yet.
"""

import atexit
import errno
import io
import os
import re
import resource
import select
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from contextlib import chdir, nullcontext
from functools import partial
from importlib import import_module
from typing import Any, BinaryIO, cast

from robots.errors import NO_ROOM, printable

LACKING, BAD_INPUT, INTERRUPTED, BROKEN = 1, 2, 130, 70
"""Exit codes where the computer lacks room, memory or open files, after bad input, after Ctrl-C, and after a defect."""
RESOURCES = {
    **dict.fromkeys((*NO_ROOM, errno.EROFS, errno.EACCES), "a temporary file"),
    **dict.fromkeys((errno.EMFILE, errno.ENFILE), "a file, a pipe or a process"),
    errno.EAGAIN: "a process or a thread",
    errno.ENOMEM: "memory",
}
"""Errors of a computer that lacks something, and what could not be created, unless the error names a file."""
NO_MEMORY = (
    "can't allocate memory",
    "cannot allocate memory",
    "failed to map segment from shared object",
)
"""Words, in lower case, of RuntimeErrors of torch and ImportErrors of library loaders that lack memory."""
NO_THREAD = "can't start new thread"
"""Message of a RuntimeError of Python's where the system starts no further thread."""
NO_FOLDER = "No usable temporary directory"
"""Beginning of the message of a FileNotFoundError where no folder for temporary files can be written."""
ADDRESSES_MIN, STACK_MIN = 1 << 30, 1 << 20
"""Least bytes that the system must let this process address: with too few, libraries wait for them for ever; and those
of the stack of each thread: with too few, libraries end the process, and only when they need them."""
ENVIRONMENT = {
    "PYTHONSAFEPATH": "1",
    "MPLBACKEND": "agg",
    "MATPLOTLIBRC": os.devnull,
    "MUJOCO_GL": "disabled",
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONIOENCODING": "utf-8",
    "GIT_PYTHON_REFRESH": "quiet",
    "ORT_DISABLE_TELEMETRY": "1",
}
"""For this process and its children: no module is imported from the working directory, which may be a robot's folder
that somebody else has written; plots are files, and no settings of a user's change them; MuJoCo imports no renderer,
which most commands do not need, and whose import starts a process that Ctrl-C ends with a traceback; no tick waits for
a thread of numpy's; children write, and libraries' children read, text as UTF-8; GitPython is imported without git;
ONNX Runtime sends nothing to its vendor, whoever imports it."""
NOT_WANTED = (
    "TORCH.*|PYTORCH_JIT.*|PROTOCOL_BUFFERS_.*|GIT_PYTHON_GIT_EXECUTABLE|SOURCE_DATE_EPOCH"
    "|NUMPY_.*|NUMBA_.*|WORLD_SIZE"
    "|TD_.*|PYTORCH_TENSORDICT_.*|EXCLUDE_TD_FROM_PYTREE|DISPATCH_TDNN_MODULES|COMPOSITE_LP_AGGREGATE"
    "|PYTHONINSPECT|PYTHONWARNINGS|_.*_COMPLETE"
)
"""Pattern of names of variables: torch and protobuf fail at an unknown log, folder, level or implementation, GitPython
at a program that is no git, numpy at a date or a switch that is no number, and tensordict at switches and a level that
it does not know; numba compiles nothing, for another processor, or into another folder; rsl_rl takes this process for
one of several; a Python process that is inspected does not end, and one whose warnings are errors ends anywhere; typer
answers a shell instead of running."""
FOR_DEVELOPERS = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)
"""Warnings that Python itself hides."""
SIZES, SIZE = ("COLUMNS", "LINES"), "[1-9][0-9]{0,3}"
"""Variables with the size of a terminal, and pattern of a size: rich fails at other digits, and is silent at 0."""
PLOT_SETTINGS = "matplotlibrc"
"""Name of a file that matplotlib, whatever the environment says, reads in the working directory when imported."""
FAIL = ("strict", "surrogateescape")
"""Handlers by which standard output fails at a letter that it cannot show: the default ones."""


class _StandardOutput(io.FileIO):
    """Standard output or error that raises nothing when its reader is gone or its disk is full.

    If a signal interrupts a write to a full pipe, all later output is discarded, so that the command can end.
    """

    def write(self, data: Any, /) -> int:
        """Write bytes. After the first failure, warn once on standard error and discard the rest."""
        try:
            return super().write(data)
        except KeyboardInterrupt:
            if not select.select((), (self,), (), 0)[1]:
                self._discard()
            raise
        except OSError as e:
            self._discard()
            if sys.stderr is not None and self.fileno() != sys.stderr.fileno():
                print(f"warning: standard output cannot be written: {e.strerror}", file=sys.stderr)
            return memoryview(data).nbytes

    def _discard(self) -> None:
        """Discard all that is written from now on."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())


def start(module: str) -> None:
    """Import the module of a command line, and run its `cli`."""
    _fill_standard_streams()
    _check_working_directory()
    _set_environment()
    _reset_warnings()
    _reset_signals()
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and stream is getattr(sys, f"__{name}__"):
            setattr(sys, name, _kept_going(stream))
    by_default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if by_default:  # an exception could be raised inside a C extension, which makes another one of it
        signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
    try:
        _check_memory()
        with chdir("/") if os.path.lexists(PLOT_SETTINGS) else nullcontext():
            cli = import_module(module).cli
    except Exception as e:  # of a library, for something in this environment: no verdict about a robot
        raise SystemExit(report_failure(e)) from e
    _run(cli, by_default=by_default)


def _run(cli: Callable[[], None], *, by_default: bool) -> None:
    """Run a command, with Ctrl-C as an exception where Python's own handler is wanted `by_default`."""
    try:
        if by_default:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            cli()
        finally:
            _end_quietly()
    except KeyboardInterrupt:  # before or after the command itself
        raise SystemExit(INTERRUPTED) from None


def _end_quietly() -> None:
    """Let Ctrl-C and requests end a command that waits for a thread at its end, as for a disk that hangs.

    They are ignored once no thread is left: Python then ends by itself, and would not handle them as documented.
    """
    from deploy.operation.interrupts import REQUESTS

    numbers = [each for each in (signal.SIGINT, *REQUESTS) if signal.getsignal(each) is not signal.SIG_IGN]
    for number in numbers:
        atexit.register(signal.signal, number, signal.SIG_IGN)
        signal.signal(number, lambda *_: os._exit(INTERRUPTED))


def _fill_standard_streams() -> None:
    """Open the null device where a standard stream is closed: no other file gets its number, which children inherit.

    Python's own stream stays None.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is this one
            os.set_inheritable(null, True)


def _check_working_directory() -> None:
    """Exit if the working directory was deleted: libraries ask for it, and fail each in its own way."""
    try:
        os.getcwd()
    except OSError as e:
        print(f"error: working directory: {e.strerror}, expected one that exists", file=sys.stderr)
        raise SystemExit(BAD_INPUT) from e


def _set_environment() -> None:
    """Set `ENVIRONMENT`; remove what ends libraries, or lets them do something else than the command line says."""
    os.environ.update(ENVIRONMENT)
    for name, value in tuple(os.environ.items()):
        if re.fullmatch(NOT_WANTED, name) or (name in SIZES and not re.fullmatch(SIZE, value)):
            del os.environ[name]


def _reset_warnings() -> None:
    """Treat warnings as Python does unless told otherwise, here and in children: as errors they would end a tick."""
    if not sys.warnoptions:
        return
    sys.warnoptions[:] = ["default"] if sys.flags.dev_mode else []  # as subprocess expects it to be
    warnings.resetwarnings()
    for category in FOR_DEVELOPERS:
        warnings.simplefilter("ignore", category)


def _reset_signals() -> None:
    """Undo what a parent process may have left: blocked signals stop nothing, ignored children leave no exit code."""
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)


def _check_memory() -> None:
    limits = (
        (resource.RLIMIT_AS, ADDRESSES_MIN, "ulimit -v"),
        (resource.RLIMIT_STACK, STACK_MIN, "ulimit -s"),
    )
    for kind, least, name in limits:
        most, _ = resource.getrlimit(kind)
        if most != resource.RLIM_INFINITY and most < least:
            raise OSError(errno.ENOMEM, f"found {most >> 10} KiB, expected at least {least >> 10} KiB", name)


def report_failure(error: Exception) -> int:
    """Print an exception, with its traceback unless the computer lacks something; return the exit code.

    Raises:
        SystemExit: the working directory was deleted.
    """
    if _lacks_memory(error):
        first_line, *_ = str(error).splitlines() or [os.strerror(errno.ENOMEM)]
        error = OSError(errno.ENOMEM, printable(first_line))
    elif isinstance(error, RuntimeError) and str(error) == NO_THREAD:
        error = OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    elif isinstance(error, FileNotFoundError) and (error.strerror or "").startswith(NO_FOLDER):
        error = OSError(errno.ENOSPC, error.strerror)
    elif isinstance(error, FileNotFoundError) and error.filename is None:
        _check_working_directory()  # a library has asked for it
    if not isinstance(error, OSError) or error.errno not in RESOURCES:
        traceback.print_exception(error)
        return BROKEN
    about = error.filename or RESOURCES[error.errno]
    print(f"error: {printable(str(about))}: {error.strerror}", file=sys.stderr)
    return LACKING


def _lacks_memory(error: Exception) -> bool:
    """Return whether an error, of Python or of a library, is about too little memory."""
    said = str(error).lower()
    named = isinstance(error, RuntimeError | ImportError) and any(words in said for words in NO_MEMORY)
    return named or isinstance(error, MemoryError)


def _kept_going(stream: io.TextIOWrapper) -> io.TextIOWrapper:
    """Return a standard stream whose failures end nothing: those of its file, and letters that it cannot show."""
    file = _StandardOutput(stream.fileno(), "w", closefd=False)
    return io.TextIOWrapper(
        cast("BinaryIO", file) if stream.write_through else io.BufferedWriter(file),
        encoding=stream.encoding,
        errors="backslashreplace" if stream.errors in FAIL else stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


deploy_check = partial(start, "deploy.commissioning.cli")
deploy_run = partial(start, "deploy.operation.cli")
