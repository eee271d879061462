"""Zip archives of unknown origin, read with bounds."""

import io
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager

from robots.errors import FirstshiftError

MEMBERS_MAX = 10_000
RECORD = b"PK\x01\x02"
"""Signature of each entry of an archive's central directory."""
UNPACKERS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""The only two methods for which Python limits the size of one decompression step."""


@contextmanager
def open_archive(data: bytes, source: str, error: type[FirstshiftError]) -> Iterator[zipfile.ZipFile]:
    """Open an archive; its entries are counted before Python parses them.

    Members are to be read with `read_member`, or with another bound; the caller bounds the sum of their sizes.

    Raises:
        FirstshiftError: of class `error`: too many members, two of one name, or another compression.
        Exception: the data is no zip archive; the class depends on the damage.
    """
    if (count := data.count(RECORD)) > MEMBERS_MAX:
        raise error(f"{source}: found {count} members, expected at most {MEMBERS_MAX}")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = set[str]()
        for record in archive.infolist():
            if record.filename in names:
                raise error(f"{source}: found two members {record.filename:.80}, expected one")
            if record.compress_type not in UNPACKERS:
                found = f"{record.filename:.80}: found compression {record.compress_type}"
                raise error(f"{source}: {found}, expected none or {zipfile.ZIP_DEFLATED}")
            names.add(record.filename)
        yield archive


def read_member(archive: zipfile.ZipFile, name: str) -> bytes:
    """Return a member: no more of it is unpacked than it states, where `archive.read` unpacks up to 2 GiB."""
    with archive.open(name) as stream:
        return stream.read(archive.getinfo(name).file_size)
