"""Keys from standard input, a terminal or a pipe, without waiting for them.

A terminal gives all keys that were pressed since the last time, so that none acts late. A pipe gives one key at a time,
so that a text of keys plays at the pace of the robot.
"""

import os
import re
import select
import sys
import termios
import tty
from contextlib import suppress
from types import TracebackType
from typing import Any, Self

from robots.errors import ConfigError

END = "end"
"""Key that stands for the end of the input: a terminal that was closed, a pipe that ended."""
ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
SEQUENCE = re.compile(rb"\x1b[\[O]([0-?]{0,16})([@-~]?)")
"""Control sequence of a key, in the two modes of a terminal: its parameters, such as a modifier, and its final byte.
Source: ECMA-48, section 5.4."""
INCOMPLETE = re.compile(rb"\x1b([\[O][0-?]{0,15})?")
SEQUENCE_BYTES, RECEIVED_BYTES = 19, 1024


class Keyboard:
    """Keys of an input. While it is entered, a terminal sends each key at once and does not show it.

    Keys of a terminal that were pressed before it is entered are dropped. Its own settings come back on every way out
    of the block.

    Attributes:
        terminal: keys come from a terminal.
    """

    def __init__(self, stream: Any = None) -> None:
        """Take an open file, by default standard input.

        Raises:
            ConfigError: there is no such input.
        """
        try:
            self._input: int = (stream or sys.stdin).fileno()
        except (AttributeError, OSError, ValueError) as e:
            raise ConfigError("--policy jog: standard input is closed, expected a terminal or a pipe") from e
        self._pending, self._ended, self.terminal = b"", False, os.isatty(self._input)
        self._settings: list[Any] | None = None

    def __enter__(self) -> Self:
        if self.terminal:
            try:
                self._settings = termios.tcgetattr(self._input)
                tty.setcbreak(self._input, termios.TCSAFLUSH)
            except termios.error as e:
                raise ConfigError(
                    "--policy jog: found a terminal that was closed, expected an open one"
                ) from e
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._settings is not None:
            with suppress(termios.error):  # the terminal has gone
                termios.tcsetattr(self._input, termios.TCSANOW, self._settings)

    def read(self) -> list[str]:
        """Return new keys: characters, names of arrows, "unknown", or `END`; empty if there are none yet.

        A sequence of which the end has not arrived waits for it.
        """
        self._receive()
        keys = [END] if self._ended and not self._pending else []
        while self._pending and (self.terminal or not keys):
            if INCOMPLETE.fullmatch(self._pending) and not self._ended:
                break
            keys.append(self._next())
        return keys

    def _next(self) -> str:
        if sequence := SEQUENCE.match(self._pending):
            self._pending = self._pending[sequence.end() :]
            parameters, final = sequence.groups()
            return "unknown" if parameters else ARROWS.get(final.decode(), "unknown")
        key, self._pending = self._pending[:1], self._pending[1:]
        return key.decode(errors="replace")

    def _receive(self) -> None:
        if (
            self._ended
            or len(self._pending) >= SEQUENCE_BYTES
            or not select.select([self._input], [], [], 0)[0]
        ):
            return
        try:
            found = os.read(self._input, RECEIVED_BYTES)
        except OSError:  # the terminal has gone
            found = b""
        self._ended = not found
        self._pending += found
