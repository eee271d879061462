"""Errors that firstshift raises on purpose.

A message names the file, the field, the value found and the value or bound expected.
"""


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
    """A result of work that was done, or of a motion, that cannot be written. Exit code 1."""


def printable(text: str) -> str:
    """Return text with "?" for every control character: names from files must not control a terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)


def is_utf8(name: str) -> bool:
    """Return whether a file name is UTF-8: C++ libraries, and JSON, cannot hold any other one."""
    return not any("\ud800" <= c <= "\udfff" for c in name)
