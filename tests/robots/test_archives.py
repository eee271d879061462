import io
import tracemalloc
import warnings
import zipfile
import zlib

import pytest

from robots import archives
from robots.archives import open_archive, read_member
from robots.errors import ConfigError


def zipped(members, compression=zipfile.ZIP_STORED):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as archive, warnings.catch_warnings(action="ignore"):
        for name, data in members:
            archive.writestr(name, data)
    return stream.getvalue()


def read(data):
    with open_archive(data, "a.zip", ConfigError) as archive:
        return {name: read_member(archive, name) for name in archive.namelist()}


def refused(data):
    with pytest.raises(ConfigError) as caught:
        read(data)
    return str(caught.value)


def inflates_to_more(stated, size):
    """An archive whose member is deflated from `size` bytes more than it states."""
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    data = deflate.compress(stated + bytes(size)) + deflate.flush()
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(zipfile.ZipInfo("a"), data)
        record = archive.filelist[0]
        record.compress_type, record.file_size = zipfile.ZIP_DEFLATED, len(stated)
        record.CRC = zlib.crc32(stated)
    return stream.getvalue()


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_members_are_read(compression):
    members = {"a": b"12", "folder/b": bytes(10**6), "empty": b""}
    assert read(zipped(members.items(), compression)) == members


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compressions_are_refused_since_nothing_bounds_them(compression):
    found = refused(zipped([("a", bytes(1000))], compression))
    assert found == f"a.zip: a: found compression {compression}, expected none or 8"


def test_two_members_of_one_name_are_refused():
    assert (
        refused(zipped([("a", b"1"), ("b", b""), ("a", b"2")])) == "a.zip: found two members a, expected one"
    )


def test_members_are_counted_before_they_are_parsed(monkeypatch):
    data = zipped([("a", b""), ("b", b""), ("c", b"")])
    monkeypatch.setattr(archives, "MEMBERS_MAX", 3)
    assert len(read(data)) == 3
    monkeypatch.setattr(archives, "MEMBERS_MAX", 2)
    monkeypatch.setattr(zipfile, "ZipFile", None)
    assert refused(data) == "a.zip: found 3 members, expected at most 2"


def test_no_more_is_unpacked_than_a_member_states():
    data = inflates_to_more(b"stated" * 1000, 1 << 25)
    tracemalloc.start()
    try:
        assert read(data) == {"a": b"stated" * 1000}
        assert tracemalloc.get_traced_memory()[1] < 1 << 21
    finally:
        tracemalloc.stop()
