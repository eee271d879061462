import errno
import fcntl
import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from deploy.telemetry.folder_lock import LOCK, locked
from robots.errors import OutputError
from support.refusals import in_use

WITHOUT_ROOM = """
import resource, signal, sys
from pathlib import Path
from deploy.telemetry.folder_lock import locked
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
with locked(Path(sys.argv[1])):
    pass
"""
HOLDER = """
import sys, time
from pathlib import Path
from deploy.telemetry.folder_lock import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(3600)
"""


def refused(folder, owner):
    with pytest.raises(OutputError) as caught, locked(folder):
        pass
    assert str(caught.value) == in_use(folder, owner)


def test_folder_is_locked_until_the_block_ends(tmp_path):
    with locked(tmp_path):
        refused(tmp_path, os.getpid())
        refused(tmp_path, os.getpid())
    assert os.listdir(tmp_path) == []
    with locked(tmp_path):
        pass


def test_another_process_is_named_and_its_lock_ends_with_it(tmp_path):
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "locked\n"
        refused(tmp_path, holder.pid)
        holder.kill()
    assert os.listdir(tmp_path) == [LOCK]
    with locked(tmp_path):
        refused(tmp_path, os.getpid())
    assert os.listdir(tmp_path) == []


def test_file_deleted_while_it_was_opened_locks_nothing(tmp_path, monkeypatch):
    """Its owner ends, and another run begins, between the two steps of a third one."""
    flock = fcntl.flock
    with ExitStack() as first, ExitStack() as second:
        first.enter_context(locked(tmp_path))

        def late(*arguments):
            monkeypatch.undo()
            first.close()
            second.enter_context(locked(tmp_path))
            flock(*arguments)

        monkeypatch.setattr(fcntl, "flock", late)
        refused(tmp_path, os.getpid())


def test_folder_that_turns_read_only_hides_no_error(tmp_path, monkeypatch):
    def read_only(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    def lose_result():
        with locked(tmp_path):
            monkeypatch.setattr(Path, "unlink", read_only)
            raise OutputError("not kept")

    with pytest.raises(OutputError, match="not kept"):
        lose_result()
    monkeypatch.undo()
    with locked(tmp_path):
        pass


def test_folder_that_cannot_be_locked_is_an_error(tmp_path):
    (tmp_path / LOCK).mkdir()
    with (
        pytest.raises(OutputError, match=rf"--out {tmp_path}: .lock cannot be locked: Is a directory"),
        locked(tmp_path),
    ):
        pass


def test_a_lock_that_is_a_link_is_refused_and_its_file_kept(tmp_path):
    (tmp_path / "precious").write_text("as it was")
    (tmp_path / LOCK).symlink_to("precious")
    with pytest.raises(OutputError, match="cannot be locked: found a link"), locked(tmp_path):
        pass
    assert (tmp_path / "precious").read_text() == "as it was"


def test_a_lock_that_is_a_hard_link_is_refused_and_its_file_kept(tmp_path):
    for contents in ("as it was", "", "123"):
        (tmp_path / "precious").write_text(contents)
        os.link(tmp_path / "precious", tmp_path / LOCK)
        with pytest.raises(OutputError, match="cannot be locked: found a hard link"), locked(tmp_path):
            pass
        assert (tmp_path / LOCK).read_text() == contents
        (tmp_path / LOCK).unlink()


@pytest.mark.parametrize("contents", [b"as it was", b"123\n", b"\xff", "\u0663".encode(), b"1" * 21])
def test_a_lock_of_another_program_is_refused_and_kept(tmp_path, contents):
    (tmp_path / LOCK).write_bytes(contents)
    with pytest.raises(OutputError) as caught, locked(tmp_path):
        pass
    found = "found a file that no run has left, expected the number of a process or nothing"
    assert str(caught.value) == f"--out {tmp_path}: {LOCK} cannot be locked: {found}"
    assert (tmp_path / LOCK).read_bytes() == contents


@pytest.mark.parametrize("contents", ["", "1", "1" * 20])
def test_a_lock_that_a_run_left_is_taken_over(tmp_path, contents):
    (tmp_path / LOCK).write_text(contents)
    with locked(tmp_path):
        assert (tmp_path / LOCK).read_text() == str(os.getpid())
    assert os.listdir(tmp_path) == []


def test_a_lock_that_is_a_pipe_is_refused(tmp_path):
    os.mkfifo(tmp_path / LOCK)
    with pytest.raises(OutputError, match=r"\.lock cannot be locked: \w"), locked(tmp_path):
        pass


def test_a_lock_without_room_on_the_disk_names_it(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_ROOM, tmp_path], capture_output=True, text=True, check=False
    )
    last = done.stderr.strip().rpartition("\n")[2]
    assert last == f"robots.errors.ResultLostError: --out {tmp_path}: .lock cannot be locked: File too large"
