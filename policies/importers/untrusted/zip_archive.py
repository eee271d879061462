"""Zip archives of unknown origin, torch's and others': only what is needed of one is read, nothing is written."""

import io
import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from robots.errors import ContractError

BYTES_MAX = 256 << 20
"""Of a file, and of all that it unpacks to."""
MEMBERS_MAX = 10_000
FOLDER = "policy"
RECORD = b"PK\x01\x02"
"""Begins each line of an archive's table of contents."""
UNPACKERS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Python bounds what it unpacks at once in these two alone."""

T = TypeVar("T")


def read_bytes(path: Path, expected: str) -> bytes:
    """All of a file; `expected` ends messages: "expected a checkpoint of …".

    Raises:
        ContractError: it cannot be read, or is too large.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(BYTES_MAX + 1)
    except OSError as e:
        raise ContractError(f"{path}: cannot be read: {e.strerror}, {expected}") from e
    if len(data) > BYTES_MAX:
        raise ContractError(f"{path}: found more than {BYTES_MAX} bytes, {expected}")
    return data


def read_names(data: bytes, source: str, expected: str) -> set[str]:
    """The names of all that an archive holds.

    Raises:
        ContractError: it is none, or holds too much.
    """
    return _asked(data, source, expected, lambda archive: set(archive.namelist()))


def read_members(data: bytes, needed: re.Pattern[str], source: str, expected: str) -> dict[str, bytes]:
    """What an archive holds under names that match.

    Raises:
        ContractError: it is none, holds too much, or is packed in another way than torch packs.
    """

    def read(archive: zipfile.ZipFile) -> dict[str, bytes]:
        records = [record for record in archive.infolist() if needed.fullmatch(record.filename)]
        for record in records:
            if record.compress_type not in UNPACKERS:
                found = f"{record.filename}: found compression {record.compress_type}"
                raise ContractError(f"{source}: {found}, expected none")
        return {record.filename: archive.read(record) for record in records}

    return _asked(data, source, expected, read)


def read_torch_members(data: bytes, needed: re.Pattern[str], source: str, expected: str) -> dict[str, bytes]:
    """The same of an archive of torch, by names inside its one outer folder.

    Raises:
        ContractError: as `read_members` does, or there are more such folders.
    """
    if len(folders := {name.partition("/")[0] for name in read_names(data, source, expected)}) != 1:
        raise ContractError(f"{source}: found {len(folders)} outer folders, expected one")
    inside = re.compile(rf"[^/]*/({needed.pattern})", re.DOTALL)
    members = read_members(data, inside, source, expected)
    return {name.partition("/")[2]: content for name, content in members.items()}


def packed(members: Mapping[str, bytes]) -> io.BytesIO:
    """The same again as torch reads it; what another reading of the file would have found is gone."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in members.items():
            archive.writestr(f"{FOLDER}/{name}", data)
    stream.seek(0)
    return stream


def _asked(data: bytes, source: str, expected: str, question: Callable[[zipfile.ZipFile], T]) -> T:
    """An archive's answer, if it is no larger than it may be: its table is counted before any of it is kept."""
    if (count := data.count(RECORD)) > MEMBERS_MAX:
        raise ContractError(f"{source}: found {count} members, expected at most {MEMBERS_MAX}")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(record.file_size for record in archive.infolist())
            if size > BYTES_MAX:
                raise ContractError(f"{source}: found {size} bytes unpacked, expected at most {BYTES_MAX}")
            return question(archive)
    except ContractError:
        raise
    except Exception as e:  # bytes of unknown origin can fail in any way
        raise ContractError(
            f"{source}: found no archive that can be read: a {type(e).__name__}, {expected}"
        ) from e
