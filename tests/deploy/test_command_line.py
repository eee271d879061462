"""Exit codes of errors."""

import errno
import os

import pytest
import typer

from deploy.command_line import BUDGET_EXCEEDED, NO_ROOM, exit_code_of
from deploy.start import BROKEN


@pytest.mark.parametrize("number", NO_ROOM)
def test_a_disk_without_room_for_a_temporary_file_is_one_line_and_no_defect(number, capsys):
    def full():
        raise OSError(number, os.strerror(number))

    assert exit_code_of(full) == BUDGET_EXCEEDED
    assert capsys.readouterr().err == f"error: a temporary file: {os.strerror(number)}\n"


def test_other_errors_of_the_system_are_defects(capsys):
    def broken():
        raise OSError(errno.EIO, "input/output error", "/dev/x")

    with pytest.raises(typer.Exit) as caught:
        exit_code_of(broken)
    assert caught.value.exit_code == BROKEN
    assert "Traceback" in capsys.readouterr().err
