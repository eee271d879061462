"""Lock of an output folder: of two runs into one folder, one would replace the files of the other."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from errno import ELOOP
from pathlib import Path
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
        OutputError: naming the folder and the process that has locked it, or the file of another program.
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
            if not _is_lock(file):
                raise OutputError(
                    f"--out {folder}: {LOCK}: found a file of another program, expected one of firstshift, or none"
                )
            file.truncate(0)
            file.write(str(os.getpid()))
            file.flush()
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


def _reason(error: OSError) -> str:
    return (
        "found a link, expected a file or nothing" if error.errno == ELOOP else error.strerror or str(error)
    )


def _is_lock(file: IO[str]) -> bool:
    """Return True if a file has no second name, and holds a process's number or nothing: it will be deleted."""
    file.seek(0)
    text = file.read(CHARACTERS + 1)
    of_process = not text or (len(text) <= CHARACTERS and text.isdecimal())
    return of_process and os.fstat(file.fileno()).st_nlink <= 1


def _is_current(file: IO[str], path: Path) -> bool:
    """Return True unless the owner before deleted the file after it was opened here: a third process has a new one."""
    return os.path.exists(path) and os.path.samestat(os.fstat(file.fileno()), path.stat())
