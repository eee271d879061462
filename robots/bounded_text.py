"""Text of unknown origin: size, nesting and length of numbers are bounded before it is parsed."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from robots.errors import ConfigError, FirstshiftError
from robots.files import read_file

DEPTH_MAX = 64
"""Nesting of tables and lists: parsers, and whatever walks through their results, call themselves for each level."""
DIGITS_MAX = 100
"""Digits of a number: enough for any of double precision or a seed, too few for one beyond the range of a float."""
LISTS_FREE, LIST_CHARACTERS = 10_000, 32
"""Lists, objects and tables that a text of any length may hold, and characters for each further one: an empty list,
three characters, takes fifty times as much memory."""

STRINGS = {
    "JSON": re.compile(r'"(?:[^"\\]|\\.)*+"?', re.DOTALL),
    "TOML": re.compile(
        r'"""(?:(?!""")[^\\]|\\.)*+(?:"{3,5})?|'
        r"'''(?:(?!''').)*+(?:'{3,5})?|"
        r'"(?:[^"\\\n]|\\[^\n])*+"?|'
        r"'[^'\n]*+'?|"
        r"#[^\n]*",
        re.DOTALL,
    ),
}
"""Strings, and comments: what is in them nests nothing and is no number. One without an end counts up to where a
parser would miss it: each character is looked at once, whatever the text."""
LEVELS = {"JSON": re.compile(r"[\[\]{}]"), "TOML": re.compile(r"[\[\]{}.,\n]")}
"""Characters that begin or end a level. In TOML a dot in a key begins one, which ends with the key's value."""
LONG_NUMBER = re.compile(rf"(?<!\w)\d\w{{{DIGITS_MAX},}}")


def read_text(path: Path, characters_max: int, error: type[FirstshiftError] = ConfigError) -> str:
    """Return the text of a regular file in UTF-8, of at most `characters_max` bytes.

    Raises:
        FirstshiftError: of class `error`: it is unreadable, too large, or no text.
    """
    try:
        return read_file(path, characters_max, error).decode("utf-8")
    except UnicodeDecodeError as e:
        raise error(f"{path}: not valid UTF-8: {e}") from e


def check_text(
    text: str, kind: Literal["JSON", "TOML"], source: str, characters_max: int, error: type[FirstshiftError]
) -> None:
    """Refuse text that is too long, nested too deeply, or has too many lists, or a number of too many digits.

    Raises:
        FirstshiftError: of class `error`, naming `source`, what was found, and the bound.
    """
    if len(text) > characters_max:
        raise error(f"{source}: found {len(text)} characters of {kind}, expected at most {characters_max}")
    bare = STRINGS[kind].sub('"', text)
    lists, most = bare.count("[") + bare.count("{"), LISTS_FREE + len(text) // LIST_CHARACTERS
    if lists > most:
        objects = "objects" if kind == "JSON" else "tables"
        raise error(f"{source}: found {lists} lists and {objects} of {kind}, expected at most {most}")
    if (depth := _depth(found[0] for found in LEVELS[kind].finditer(bare))) > DEPTH_MAX:
        raise error(f"{source}: found {kind} nested {depth} deep, expected at most {DEPTH_MAX}")
    check_numbers(bare, source, error)


def check_numbers(text: str, source: str, error: type[FirstshiftError]) -> None:
    """Refuse text with a number of too many digits.

    Raises:
        FirstshiftError: of class `error`, naming `source`, the number, and the bound.
    """
    if number := LONG_NUMBER.search(text):
        found = f"{number[0]:.20}… of {len(number[0])} digits"
        raise error(f"{source}: found the number {found}, expected at most {DIGITS_MAX}")


def _depth(tokens: Iterable[str]) -> int:
    """Return the largest number of levels that are open at once."""
    deepest = depth = 0
    dots = [0]
    for token in tokens:
        if token in "[{":
            dots.append(0)
            depth += 1
        elif token == ".":
            dots[-1] += 1
            depth += 1
        else:
            depth -= dots[-1]
            dots[-1] = 0
            if token in "]}" and len(dots) > 1:
                dots.pop()
                depth -= 1
        deepest = max(deepest, depth)
    return deepest
