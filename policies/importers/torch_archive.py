"""Torch's archives of unknown origin: only what is needed of one is read, and torch is only shown what was read."""

import io
import re
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

from robots.errors import ContractError

UNPACKED_BYTES_MAX = 256 << 20
MEMBERS_MAX = 10_000
FOLDER = "policy"


def read_members(path: Path, needed: re.Pattern[str]) -> dict[str, bytes]:
    """What a zip file holds under names that match, its one outer folder left out.

    Raises:
        ContractError: it is no such archive, or unpacks to too much.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            records = archive.infolist()
            _check_sizes(records, path)
            inner = {record.filename.partition("/")[2]: record for record in records}
            return {name: archive.read(record) for name, record in inner.items() if needed.fullmatch(name)}
    except OSError as e:
        raise ContractError(f"{path}: cannot be read: {e.strerror or e}") from e
    except (zipfile.BadZipFile, zlib.error, ValueError, NotImplementedError, RuntimeError, EOFError) as e:
        raise ContractError(f"{path}: found no torch archive that can be read: a {type(e).__name__}") from e


def packed(members: Mapping[str, bytes]) -> io.BytesIO:
    """The same again as torch reads it; what another reading of the file would have found is gone."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in members.items():
            archive.writestr(f"{FOLDER}/{name}", data)
    stream.seek(0)
    return stream


def _check_sizes(records: list[zipfile.ZipInfo], path: Path) -> None:
    if len(records) > MEMBERS_MAX:
        raise ContractError(f"{path}: found {len(records)} members, expected at most {MEMBERS_MAX}")
    if (size := sum(record.file_size for record in records)) > UNPACKED_BYTES_MAX:
        raise ContractError(f"{path}: found {size} bytes unpacked, expected at most {UNPACKED_BYTES_MAX}")
    if len(folders := {record.filename.partition("/")[0] for record in records}) != 1:
        raise ContractError(f"{path}: found {len(folders)} outer folders, expected one")
