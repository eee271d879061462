"""Reading of files of unknown origin: regular files of bounded size."""

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from robots.errors import ConfigError, FirstshiftError

KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}
"""Files that are not opened: they may never end, block, or do something when opened."""
CHUNK = 1 << 20
"""Bytes read at once."""


def read_file(
    path: Path, bytes_max: int, error: type[FirstshiftError] = ConfigError, expected: str = ""
) -> bytes:
    """Return the bytes of a regular file, at most `bytes_max`; `expected` ends messages: "expected a policy".

    Raises:
        FirstshiftError: of class `error`: it is missing, unreadable, too large or no regular file.
    """
    ending = expected and f", {expected}"
    try:
        found = path.stat()
        if kind := KINDS.get(stat.S_IFMT(found.st_mode)):
            raise error(f"{path}: cannot be read: found {kind}, expected a regular file")
        if stat.S_ISREG(found.st_mode) and found.st_size > bytes_max:
            raise error(f"{path}: found {found.st_size} bytes, at most {bytes_max}{ending}")
        with open(path, "rb", opener=_open_without_waiting) as stream:
            data = b"".join(_chunks(stream, bytes_max + 1))
    except OSError as e:
        raise error(f"{path}: cannot be read: {e.strerror}{ending}") from e
    except ValueError as e:  # a zero byte in its name
        raise error(f"{str(path)!r:.200}: cannot be read: {e}{ending}") from e
    if len(data) > bytes_max:
        raise error(f"{path}: found {len(data)} bytes or more, at most {bytes_max}{ending}")
    return data


def is_missing(path: Path) -> bool:
    """Return True if there is certainly no file; False if its folder cannot be read: reading the file tells why."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        return False
    return False


def _chunks(stream: BinaryIO, bytes_max: int) -> Iterator[bytes]:
    """Yield at most `bytes_max`: one read of so many would need as much memory for a small file."""
    while chunk := stream.read(min(CHUNK, bytes_max)):
        yield chunk
        bytes_max -= len(chunk)


def _open_without_waiting(path: str, flags: int) -> int:
    """Open a file that may have become a pipe since it was looked at."""
    return os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY)
