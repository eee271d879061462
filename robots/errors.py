"""Errors that firstshift raises on purpose.

A message names the file, the field, the value found and the value or bound expected.
"""

import errno

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of the system for a full disk, an exhausted quota, and a limit of the size of a file."""


class FirstshiftError(Exception):
    """Base of all errors that a user can correct. Exit code 2: bad input, nothing moved, nothing overwritten."""


class RobotError(FirstshiftError):
    """A robot folder that cannot be read or makes no sense."""


class ContractError(FirstshiftError):
    """A policy that does not match its contract, its robot or its rates."""


class ConfigError(FirstshiftError):
    """A settings file or an option out of bounds."""


class OutputError(FirstshiftError):
    """A place that cannot be written."""


class ResultLostError(OutputError):
    """A result that cannot be kept: the disk has no room, or work was done, or a robot moved. Exit code 1."""


def output_error(message: str, cause: OSError) -> OutputError:
    """Return the error for a place that cannot be written; a `ResultLostError` if the disk has no room."""
    return (ResultLostError if cause.errno in NO_ROOM else OutputError)(message)


def printable(text: str) -> str:
    """Return text with "?" for every control character: names from files must not control a terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)


def is_utf8(name: str) -> bool:
    """Return whether a file name is UTF-8: C++ libraries, and JSON, cannot hold any other one."""
    return not any("\ud800" <= c <= "\udfff" for c in name)
