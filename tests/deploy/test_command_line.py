"""Exit codes of errors."""

import errno
import os
import tempfile

import pytest
import typer

from deploy.command_line import BUDGET_EXCEEDED, exit_code_of
from deploy.start import BROKEN, LACKING, RESOURCES


def code_of(command):
    with pytest.raises(typer.Exit) as caught:
        exit_code_of(command)
    return caught.value.exit_code


@pytest.mark.parametrize("number", RESOURCES)
@pytest.mark.parametrize("name", [None, "a\nb"])
def test_a_computer_without_room_is_one_line_and_no_defect(number, name, capsys):
    def full():
        raise OSError(number, os.strerror(number), name)

    assert code_of(full) == BUDGET_EXCEEDED == LACKING
    about = "a?b" if name else RESOURCES[number]
    assert capsys.readouterr().err == f"error: {about}: {os.strerror(number)}\n"


@pytest.mark.parametrize("said", ["", "Unable to allocate 8 GiB"])
def test_a_computer_without_memory_is_one_line_and_no_defect(said, capsys):
    def full():
        raise MemoryError(said)

    assert code_of(full) == LACKING
    assert capsys.readouterr().err == f"error: memory: {said or os.strerror(errno.ENOMEM)}\n"


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (RuntimeError, "DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes."),
        (ImportError, "libscipy.so: failed to map segment from shared object"),
        (ImportError, "libscipy.so: cannot create shared object descriptor: Cannot allocate memory"),
    ],
)
def test_a_library_without_memory_is_one_line_and_no_defect(kind, said, capsys):
    def full():
        raise kind(f"{said}\nC++ frames")

    assert code_of(full) == LACKING
    assert capsys.readouterr().err == f"error: memory: {said}\n"


def test_no_temporary_folder_is_one_line_and_no_defect(monkeypatch, capsys):
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: ["/nowhere"])
    assert code_of(tempfile.gettempdir) == LACKING
    said = "No usable temporary directory found in ['/nowhere']"
    assert capsys.readouterr().err == f"error: a temporary file: {said}\n"


def test_other_errors_of_libraries_are_defects(capsys):
    def broken():
        raise RuntimeError("mat1 and mat2 shapes cannot be multiplied")

    assert code_of(broken) == BROKEN
    assert "Traceback" in capsys.readouterr().err


def test_other_errors_of_the_system_are_defects(capsys):
    def broken():
        raise OSError(errno.EIO, "input/output error", "/dev/x")

    assert code_of(broken) == BROKEN
    assert "Traceback" in capsys.readouterr().err
