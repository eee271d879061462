"""Files of every kind that a file system has: only regular ones are opened."""

import os
import socket

import pytest

from robots.errors import ConfigError, RobotError
from robots.files import read_file
from robots.models.files import read_xml
from robots.strict import Strict, read_json_file, read_toml


def pipe(folder):
    os.mkfifo(folder / "x")
    return folder / "x"


def unix_socket(folder, monkeypatch):
    monkeypatch.chdir(folder)  # its path may have a hundred characters only
    with socket.socket(socket.AF_UNIX) as made:
        made.bind("x")
    return folder / "x"


READERS = {
    "bytes": lambda path: read_file(path, 100),
    "TOML": lambda path: read_toml(path, Strict),
    "JSON": lambda path: read_json_file(path, 100),
    "XML": read_xml,
}


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_no_reader_waits_for_a_pipe_or_reads_a_device(tmp_path, read):
    for path, kind in ((pipe(tmp_path), "a named pipe"), ("/dev/zero", "a device")):
        with pytest.raises((ConfigError, RobotError)) as caught:
            read(type(tmp_path)(path))
        assert str(caught.value) == f"{path}: cannot be read: found {kind}, expected a regular file"


def test_sockets_folders_and_impossible_names_are_refused(tmp_path, monkeypatch):
    with pytest.raises(ConfigError, match="found a socket, expected a regular file"):
        read_file(unix_socket(tmp_path, monkeypatch), 100)
    with pytest.raises(ConfigError, match=r": cannot be read: Is a directory, expected a policy$"):
        read_file(tmp_path, 100, expected="expected a policy")
    with pytest.raises(ConfigError, match=r"a\\x00b': cannot be read: embedded null"):
        read_file(tmp_path / "a\0b", 100)


def test_size_is_bounded_also_where_it_is_unknown_beforehand(tmp_path):
    path = tmp_path / "x"
    path.write_bytes(bytes(100))
    assert read_file(path, 100) == bytes(100)
    with pytest.raises(ConfigError, match=r"x: found 100 bytes, at most 99$"):
        read_file(path, 99)
    with pytest.raises(ConfigError, match=r"^/proc/self/status: found 11 bytes or more, at most 10$"):
        read_file(type(path)("/proc/self/status"), 10)
