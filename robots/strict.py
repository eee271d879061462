"""Strict reading of files: every key known, every key present, every value inside its bounds."""

import json
import tomllib
from collections import Counter
from collections.abc import Iterator
from datetime import date, time
from itertools import islice
from pathlib import Path
from reprlib import Repr
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from robots.bounded_text import check_text, read_text
from robots.errors import ConfigError, FirstshiftError


class Strict(BaseModel):
    """Frozen record from a file: no unknown keys, no text or boolean for a number, no NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Positive = Annotated[float, Field(ge=1e-12, le=1e9)]
"""Physical quantity above zero, in SI units: products and quotients of several are still floats."""
NotNegative = Annotated[float, Field(ge=0, le=1e9)]
Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]
"""Physical quantity of either sign, such as a coordinate, m."""

Source = Annotated[str, Field(min_length=1)]
"""Origin of the numbers of a table, or "estimate"."""


def _printable(name: str) -> str:
    if not name.isprintable():
        raise ValueError("expected printable characters")
    return name


Name = Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_printable)]
"""Name of a part of a robot: reports and terminals show it."""
ROBOT_NAME = r"^[A-Za-z0-9_-]{1,64}$"
RobotName = Annotated[str, Field(pattern=ROBOT_NAME)]
"""Name of a robot."""

PLACEHOLDER = "?"
"""Value of a draft that is still to be filled in."""
TOML_CHARACTERS_MAX = 1 << 20
LINES_MAX, WRONG_MAX = 20, 10_000
"""Most wrong fields that an error names one by one, and most of which any is named; others are counted."""
KEYS_MAX = 1 << 16
"""Keys of an object of JSON."""
OPEN_FIELDS_MAX = 1000
"""Fields still to be filled in that an error names: drafts of robot-init have fewer."""


def is_none(value: object) -> bool:
    """Return True if a key is left out: it is left out of what is written, too."""
    return value is None


M = TypeVar("M", bound=Strict)
T = TypeVar("T")
Many = Annotated[tuple[T, ...], Field(fail_fast=True)]
"""List in a large file. Validation ends at its first wrong item: each takes 0.5 to 1 kB."""


def read_toml(path: Path, schema: type[M], error: type[FirstshiftError] = ConfigError) -> M:
    """Read a TOML file into a strict record; an `error` names file, key, value and expectation.

    Raises:
        FirstshiftError: of class `error`, naming file, key, value and expectation.
    """
    text = read_text(path, TOML_CHARACTERS_MAX, error)
    check_text(text, "TOML", str(path), TOML_CHARACTERS_MAX, error)
    try:
        data = tomllib.loads(text)
    except ValueError as e:
        raise error(f"{path}: not valid TOML: {e}") from e
    reject_placeholders(data, str(path), error)
    return parse(data, schema, source=str(path), error=error)


def reject_placeholders(data: object, source: str, error: type[FirstshiftError]) -> None:
    """Refuse a draft with fields still to be filled in: the first ones are named, the others counted.

    Raises:
        FirstshiftError: of class `error`, one line for each of the first `OPEN_FIELDS_MAX`.
    """
    still = (f"{field}: still {PLACEHOLDER!r}, to be filled in" for field in placeholder_fields(data))
    if lines := list(_first(still, OPEN_FIELDS_MAX)):
        raise error("\n".join(f"{source}: {line}" for line in lines))


def placeholder_fields(data: object, field: str = "") -> Iterator[str]:
    """Yield the names of fields of plain data that are still to be filled in."""
    if data == PLACEHOLDER:
        yield field
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        named = isinstance(value, dict) and value.get("name", PLACEHOLDER) != PLACEHOLDER
        name = f"{value['name'] if named else key!s:.80}"
        yield from placeholder_fields(value, f"{field}.{name}" if field else name)


def read_json(
    text: str, source: str, characters_max: int, error: type[FirstshiftError] = ConfigError
) -> object:
    """Return plain data from JSON of at most `characters_max`; `source` names its origin in an `error`.

    Raises:
        FirstshiftError: of class `error`: too long, nested too deeply, with too long numbers, with a key more than
            once in an object, or not JSON of Unicode.
    """
    check_text(text, "JSON", source, characters_max, error)
    try:
        data = json.loads(text, object_pairs_hook=_object)
        if "\\u" in text:  # half of a character, which no file and no terminal can hold
            json.dumps(data, ensure_ascii=False).encode()
        return data
    except ValueError as e:
        raise error(f"{source}: not valid JSON: {e!s:.100}, found {text!r:.40}") from e


def _object(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return an object of JSON.

    Raises:
        ValueError: it has too many keys, or one more than once, of which readers would take different ones.
    """
    if len(pairs) > KEYS_MAX:
        raise ValueError(f"{len(pairs)} keys in an object, expected at most {KEYS_MAX}")
    found = dict(pairs)
    if len(found) < len(pairs):
        (key, _), *_ = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"key {key!r:.40} more than once")
    return found


def read_json_file(path: Path, characters_max: int, source: str | None = None) -> object:
    """Return plain data from a JSON file of at most `characters_max`; errors name `source`, by default the path.

    Raises:
        ConfigError: it cannot be read, or as `read_json`.
    """
    return read_json(read_text(path, characters_max), source or str(path), characters_max)


def parse(data: object, schema: type[M], *, source: str, error: type[FirstshiftError] = ConfigError) -> M:
    """Return a strict record from plain data; an `error` names the first wrong fields of `source`, and their number.

    Raises:
        FirstshiftError: of class `error`, one line for each of the first `LINES_MAX` fields that are wrong, or their
            number alone beyond `WRONG_MAX`.
    """
    try:
        return schema.model_validate(_tuples(data))
    except ValidationError as e:
        if e.error_count() > WRONG_MAX:
            raise error(
                f"{source}: found {e.error_count():,} wrong fields, more than {WRONG_MAX:,}, expected none"
            ) from e
        raise error("\n".join(f"{source}: {line}" for line in _first(_messages(e), LINES_MAX))) from e


def _tuples(data: object) -> object:
    """Return plain data with tuples for lists: records hold tuples, TOML and JSON have lists only."""
    if isinstance(data, dict):
        return {key: _tuples(value) for key, value in data.items()}
    return tuple(_tuples(item) for item in data) if isinstance(data, list) else data


class _Short(Repr):
    """Text of a wrong value, which may be anything: of numbers, text and the beginnings of lists; others by type."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxlist, self.maxtuple = 3, 12, 12
        self.maxstring = self.maxlong = 120

    def repr_instance(self, x: object, level: int) -> str:
        """Return numbers as they are, and other values by their type: their own text may have any length."""
        plain = x is None or isinstance(x, bool | float | date | time)
        return repr(x) if plain else f"a {type(x).__name__}"


_SHORT = _Short()


def _messages(invalid: ValidationError) -> Iterator[str]:
    """Yield each error as `field: expectation, found value`."""
    errors = invalid.errors(include_url=False)
    outer = {item["loc"][:k] for item in errors for k in range(len(item["loc"]))}
    for item in errors:
        if item["type"] == "too_short" and item["loc"] in outer:
            continue  # pydantic counts only the items that are right
        field = ".".join(f"{part!s:.80}" for part in item["loc"]) or "(whole file)"
        found, message = item["input"], item["msg"].removeprefix("Value error, ")
        shown = "" if isinstance(found, dict) else f", found {_SHORT.repr(found):.80}"
        # The error of a validator of the whole record names its own field.
        own = not item["loc"] and item["type"] == "value_error"
        yield str(item["ctx"]["error"]) if own else f"{field}: {message}{shown}"


def _first(lines: Iterator[str], most: int) -> Iterator[str]:
    """Yield at most so many lines, the first ones, and one with the number of others, if any."""
    yield from islice(lines, most)
    if others := sum(1 for _ in lines):
        yield f"… and {others:,} more"
