"""Lock of an output folder: of two runs into one folder, one would replace the files of the other."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from errno import ELOOP
from pathlib import Path
from stat import S_ISREG
from typing import IO

from robots.errors import OutputError, output_error

LOCK = ".lock"
"""File in a folder that is in use, with the number of the process that uses it."""
CHARACTERS = 20


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder, which must exist, until the block ends.

    The kernel releases the lock of a process that was killed; the file that is left means nothing then.

    Raises:
        OutputError: naming the folder and the process that has locked it.
    """
    with _acquired(folder):
        try:
            yield
        finally:
            with suppress(OSError):  # it may have turned read-only; the block's own error must be seen
                (folder / LOCK).unlink()


def _acquired(folder: Path) -> IO[str]:
    """Return the locked file, which holds this process's number."""
    with ExitStack() as stack:
        try:
            file = stack.enter_context(_open(folder / LOCK))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not _is_current(file, folder / LOCK):
                return _acquired(folder)
            _check_own(file, folder)
            os.ftruncate(file.fileno(), 0)
            os.write(file.fileno(), str(os.getpid()).encode())  # unbuffered: closing must not write again
        except BlockingIOError as e:
            file.seek(0)
            owner = file.read(CHARACTERS) or "unknown"
            raise OutputError(
                f"--out {folder}: found in use by process {owner}, expected a folder that no other run uses"
            ) from e
        except OSError as e:
            raise output_error(f"--out {folder}: {LOCK} cannot be locked: {_reason(e)}", e) from e
        stack.pop_all()
        return file


def _open(path: Path) -> IO[str]:
    """Open a file for reading and appending; a link, which may lead to any file, is refused (OSError)."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    return os.fdopen(descriptor, "a+", encoding="utf-8", errors="replace")


def _check_own(file: IO[str], folder: Path) -> None:
    """Check that a locked file is one that a run left: it is emptied, and deleted later.

    Raises:
        OutputError: it has another name as well, or other contents than the number of a process.
    """
    status = os.fstat(file.fileno())
    file.seek(0)
    text = file.read(CHARACTERS + 1)
    if not S_ISREG(status.st_mode) or status.st_nlink > 1:
        found = "a hard link or a device"
    elif text and not (len(text) <= CHARACTERS and text.isascii() and text.isdigit()):
        found = "a file that no run has left"
    else:
        return
    raise OutputError(
        f"--out {folder}: {LOCK} cannot be locked: found {found}, expected the number of a process or nothing"
    )


def _reason(error: OSError) -> str:
    return (
        "found a link, expected a file or nothing" if error.errno == ELOOP else error.strerror or str(error)
    )


def _is_current(file: IO[str], path: Path) -> bool:
    """Return True unless the owner before deleted the file after it was opened here: a third process has a new one."""
    return os.path.exists(path) and os.path.samestat(os.fstat(file.fileno()), path.stat())
