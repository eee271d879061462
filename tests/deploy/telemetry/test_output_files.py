import errno
import os
import sys
from pathlib import Path

import pytest

from deploy.telemetry.output_files import add_file, check_file, check_no_input, replacing
from robots.errors import NO_ROOM, OutputError, ResultLostError


def test_a_file_is_replaced_when_the_block_ends_well(tmp_path):
    path = tmp_path / "new" / "folder" / "x.bin"
    for text in ("first", "second"):
        with replacing(path) as partial:
            partial.write_text(text)
        assert path.read_text() == text
    assert os.listdir(path.parent) == ["x.bin"]


def written_by_half(path, error):
    with replacing(path) as partial:
        partial.write_text("half")
        raise error


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_file_is_unchanged_when_the_block_raises(tmp_path, error):
    path = tmp_path / "x.bin"
    path.write_text("older")
    with pytest.raises(error):
        written_by_half(path, error)
    assert path.read_text() == "older"
    assert os.listdir(tmp_path) == ["x.bin"]


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        *((number, ResultLostError) for number in NO_ROOM),
        (errno.EROFS, OutputError),
        (errno.EIO, OutputError),
    ],
)
def test_a_full_disk_is_a_lost_result_and_another_error_a_bad_place(tmp_path, number, kind):
    with pytest.raises(OutputError) as caught, replacing(tmp_path / "x.bin"):
        raise OSError(number, os.strerror(number))
    assert type(caught.value) is kind
    assert str(caught.value) == f"--out {tmp_path / 'x.bin'}: cannot be written: {os.strerror(number)}"
    assert os.listdir(tmp_path) == []


def test_write_protected_file_is_kept(tmp_path, monkeypatch):
    path = tmp_path / "x.bin"
    path.write_text("precious")
    monkeypatch.setattr("os.access", lambda *_: False)  # root may write anything
    with pytest.raises(OutputError, match="found a write-protected file"), replacing(path):
        pass
    assert path.read_text() == "precious"


def test_a_link_stays_and_its_file_is_replaced(tmp_path):
    theirs, link = tmp_path / "theirs" / "x.bin", tmp_path / "link.bin"
    theirs.parent.mkdir()
    theirs.write_text("older")
    (tmp_path / "other.bin").symlink_to("theirs/x.bin")
    link.symlink_to("other.bin")
    check_file(link)
    with replacing(link) as partial:
        partial.write_text("newer")
    assert (os.readlink(link), os.readlink(tmp_path / "other.bin")) == ("other.bin", "theirs/x.bin")
    assert theirs.read_text() == "newer"
    assert os.listdir(theirs.parent) == ["x.bin"]


@pytest.mark.parametrize("target", ["nothing", "nothing/deeper", "link.bin"])
def test_a_link_to_no_file_is_refused(tmp_path, target):
    link = tmp_path / "link.bin"
    link.symlink_to(target)
    message = f"--out {link}: found a link to no file, expected a file or nothing"
    for call in (check_file, lambda path: replacing(path).__enter__()):
        with pytest.raises(OutputError, match=message):
            call(link)
    assert not add_file("new", link)
    assert (os.listdir(tmp_path), os.readlink(link)) == (["link.bin"], target)


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_a_link_to_an_open_file_that_was_deleted_is_refused(tmp_path):
    link = tmp_path / "link.bin"
    with (tmp_path / "x.bin").open("w") as file:
        (tmp_path / "x.bin").unlink()
        link.symlink_to(f"/proc/self/fd/{file.fileno()}")
        with pytest.raises(OutputError, match="found a link to no file"):
            check_file(link)
    assert os.listdir(tmp_path) == ["link.bin"]


@pytest.mark.parametrize("kind", ["folder", "pipe", "device"])
def test_what_is_no_regular_file_is_refused_behind_a_link_as_well(tmp_path, kind):
    place, link = tmp_path / "place", tmp_path / "link.bin"
    {"folder": place.mkdir, "pipe": lambda: os.mkfifo(place), "device": lambda: None}[kind]()
    link.symlink_to(os.devnull if kind == "device" else place)
    for path in (link, link.resolve()):
        with pytest.raises(OutputError, match=f"--out {path}: found a folder or a device, expected a file"):
            check_file(path)
    assert link.is_symlink()


def test_the_new_file_has_the_usual_permissions(tmp_path):
    (tmp_path / "plain").write_text("")
    with replacing(tmp_path / "x.bin"):
        pass
    assert (tmp_path / "x.bin").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("name", [".", "/", ""])
def test_a_place_without_a_name_is_refused(name):
    with (
        pytest.raises(OutputError, match="found a folder, expected a file or nothing"),
        replacing(Path(name)),
    ):
        pass


def test_a_place_is_checked_before_there_is_work_to_lose(tmp_path):
    (tmp_path / "x.bin").write_text("older")
    check_file(tmp_path / "x.bin")
    assert (tmp_path / "x.bin").read_text() == "older"
    for name in ("x" * 255, "x.bin/y", "."):
        with pytest.raises(OutputError, match=f"--out {tmp_path}"):
            check_file(tmp_path / name)
    assert os.listdir(tmp_path) == ["x.bin"]


@pytest.mark.parametrize("same", ["x.pt", "y/../x.pt", "link.pt"])
def test_an_input_is_not_written_over(tmp_path, same):
    (tmp_path / "y").mkdir()
    (tmp_path / "x.pt").write_text("weights")
    (tmp_path / "link.pt").symlink_to("x.pt")
    other, path = tmp_path / "y" / "x.pt", tmp_path / same
    check_no_input(other, [tmp_path / "x.pt"])
    check_no_input(path, [tmp_path / "no.pt", tmp_path / "y"])
    with pytest.raises(OutputError) as caught:
        check_no_input(path, [tmp_path / "no.pt", tmp_path / "x.pt"], "--mcap")
    assert str(caught.value) == f"--mcap {path}: found a file that is read, expected another place"
