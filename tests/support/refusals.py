import os

import pytest

from robots.errors import ContractError


def refusal(read, path, *arguments, error=ContractError, lines=1):
    """The `lines` or fewer with which `read(path, *arguments)` refuses the file, without the path in front."""
    with pytest.raises(error) as caught:
        read(path, *arguments)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert message.count("\n") < lines
    return message.removeprefix(f"{path}: ")


def in_use(folder, owner=None):
    """The error about a folder that a process, by default this one, has locked."""
    found = f"found in use by process {owner or os.getpid()}"
    return f"--out {folder}: {found}, expected a folder that no other run uses"
