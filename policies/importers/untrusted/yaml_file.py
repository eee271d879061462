"""Reader of untrusted YAML: plain data of limited size and depth, without tags, aliases and numbers in base 60."""

import re
from collections.abc import Iterator
from pathlib import Path

from robots.bounded_text import check_numbers, read_text
from robots.errors import ContractError

CHARACTERS_MAX = 1 << 18
DEPTH_MAX = 20
BASE_60 = re.compile(r"[-+]?[0-9][0-9_]*(:[0-9]+)+(\.[0-9_]*)?")
"""Number such as 1:30:00: its digits come in groups, of which there may be too many for a float, or for a message."""


def read_yaml(path: Path) -> object:
    """Return the contents of a YAML file; refuse one that is too long, too deeply nested, or not plain."""
    import yaml

    text = read_text(path, CHARACTERS_MAX, ContractError)
    check_numbers(text, str(path), ContractError)
    try:
        for complaint in _unexpected(text):
            raise ContractError(f"{path}: {complaint}")
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as e:
        problem = " ".join(str(getattr(e, "problem", None) or type(e).__name__).split())
        raise ContractError(f"{path}: not valid YAML: {problem:.200}") from e


def _unexpected(text: str) -> Iterator[str]:
    import yaml

    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        found = f"line {event.start_mark.line + 1}: found"
        if isinstance(event, yaml.AliasEvent):  # nested aliases can expand to more than the memory
            yield f"{found} the alias {event.anchor!r:.100}, expected each value in full"
        elif tag := getattr(event, "tag", None):  # values that do not fit their tag fail in many ways
            yield f"{found} the tag {tag!r:.100}, expected none"
        elif isinstance(event, yaml.ScalarEvent) and event.implicit[0] and BASE_60.fullmatch(event.value):
            yield f"{found} {event.value!r:.100}, expected a decimal number, or quotes around a text"
        if depth > DEPTH_MAX:
            yield f"found more than {DEPTH_MAX} nested levels"
