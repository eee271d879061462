"""Reader of untrusted zip archives: selected members, read in memory with limits; nothing is extracted to disk.

Files that are unreadable, no archive or too large raise ContractError.
"""

import io
import re
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from robots.archives import open_archive, read_member
from robots.errors import ContractError
from robots.files import read_file

BYTES_MAX = 256 << 20
"""Limit of a file, and of the total size of an archive's members unpacked."""
FOLDER = "policy"


def read_bytes(path: Path, expected: str, bytes_max: int | None = None) -> bytes:
    """Return the bytes of a file, at most `bytes_max` (default `BYTES_MAX`); `expected` ends error messages."""
    return read_file(path, BYTES_MAX if bytes_max is None else bytes_max, ContractError, expected)


def read_names(data: bytes, source: str, expected: str) -> set[str]:
    """Return the names of all members of an archive."""
    with _opened(data, source, expected) as archive:
        return set(archive.namelist())


def read_members(data: bytes, needed: re.Pattern[str], source: str, expected: str) -> dict[str, bytes]:
    """Return the members whose names match `needed`."""
    with _opened(data, source, expected) as archive:
        names = [name for name in archive.namelist() if needed.fullmatch(name)]
        return {name: read_member(archive, name) for name in names}


def read_torch_members(data: bytes, needed: re.Pattern[str], source: str, expected: str) -> dict[str, bytes]:
    """Return matching members of an archive of torch, named relative to its single outer folder."""
    if len(folders := {name.partition("/")[0] for name in read_names(data, source, expected)}) != 1:
        raise ContractError(f"{source}: found {len(folders)} outer folders, expected one")
    inside = re.compile(rf"[^/]*/({needed.pattern})", re.DOTALL)
    members = read_members(data, inside, source, expected)
    return {name.partition("/")[2]: content for name, content in members.items()}


def in_folder(members: Mapping[str, bytes], folder: str) -> dict[str, bytes]:
    """Return the members of a folder ("data/"), named relative to it."""
    return {name.removeprefix(folder): data for name, data in members.items() if name.startswith(folder)}


def repack(members: Mapping[str, bytes]) -> io.BytesIO:
    """Return a new archive of only these members, so that torch reads exactly what was checked."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in members.items():
            # A ZipInfo without a date: zip has none before 1980, where a clock without a battery may begin.
            archive.writestr(zipfile.ZipInfo(f"{FOLDER}/{name}"), data)
    stream.seek(0)
    return stream


@contextmanager
def _opened(data: bytes, source: str, expected: str) -> Iterator[zipfile.ZipFile]:
    """Open an archive within the limits."""
    try:
        with open_archive(data, source, ContractError) as archive:
            size = sum(record.file_size for record in archive.infolist())
            if size > BYTES_MAX:
                raise ContractError(f"{source}: found {size} bytes unpacked, expected at most {BYTES_MAX}")
            yield archive
    except ContractError:
        raise
    except Exception as e:  # bytes of unknown origin can fail in any way
        found = f"found no archive that can be read: a {type(e).__name__}"
        raise ContractError(f"{source}: {found}, {expected}") from e
