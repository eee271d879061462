"""Files of every kind that a file system has: only regular ones are opened."""

import ast
import errno
import os
import socket
import tracemalloc
from pathlib import Path

import pytest

from robots.errors import ConfigError, RobotError
from robots.files import CHUNK, is_missing, read_file
from robots.models.files import read_xml
from robots.strict import Strict, read_json_file, read_toml
from support.paths import ROOT


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


def test_a_small_file_needs_little_memory_whatever_its_bound(tmp_path):
    path = tmp_path / "x"
    path.write_bytes(bytes(CHUNK + 5))
    tracemalloc.start()
    try:
        assert read_file(path, 1 << 30) == bytes(CHUNK + 5)
        assert tracemalloc.get_traced_memory()[1] < 16 * CHUNK
    finally:
        tracemalloc.stop()


def test_size_is_bounded_also_where_it_is_unknown_beforehand(tmp_path):
    path = tmp_path / "x"
    path.write_bytes(bytes(100))
    assert read_file(path, 100) == bytes(100)
    with pytest.raises(ConfigError, match=r"x: found 100 bytes, at most 99$"):
        read_file(path, 99)
    with pytest.raises(ConfigError, match=r"^/proc/self/status: found 11 bytes or more, at most 10$"):
        read_file(type(path)("/proc/self/status"), 10)


@pytest.mark.parametrize(
    ("number", "missing"),
    [(errno.ENOENT, True), (errno.ENOTDIR, True), (errno.EACCES, False), (errno.EIO, False)],
)
def test_only_a_file_that_is_certainly_absent_is_missing(tmp_path, monkeypatch, number, missing):
    def stat(_path):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "stat", stat)
    assert is_missing(tmp_path) is missing


def test_a_file_that_exists_is_not_missing(tmp_path):
    assert not is_missing(tmp_path)
    assert is_missing(tmp_path / "x")
    assert not is_missing(tmp_path / ("x" * 300))


RAISING = {"exists", "is_dir", "is_file", "is_mount", "is_symlink"}
"""Methods of Path that raise for a name that is too long, or a folder without permission; os.path returns False."""


@pytest.mark.parametrize("package", ["deploy", "eval", "policies", "robots"])
def test_paths_are_examined_with_os_path(package):
    found = [
        f"{file.relative_to(ROOT)}:{node.lineno}: {node.func.attr}"
        for file in sorted((ROOT / package).rglob("*.py"))
        for node in ast.walk(ast.parse(file.read_bytes()))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in RAISING
        and ast.unparse(node.func.value) != "os.path"
    ]
    assert not found
