"""Reader of untrusted YAML: plain data of limited size and depth, without custom tags and aliases."""

from collections.abc import Iterator
from pathlib import Path

from robots.bounded_text import check_numbers, read_text
from robots.errors import ContractError

CHARACTERS_MAX = 1 << 18
DEPTH_MAX = 20


def read_yaml(path: Path) -> object:
    """Return the contents of a YAML file; refuse one that is too long, too deeply nested, or has an alias."""
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
        if isinstance(event, yaml.AliasEvent):  # nested aliases can expand to more than the memory
            found = f"line {event.start_mark.line + 1}: found the alias {event.anchor!r:.100}"
            yield f"{found}, expected each value in full"
        if depth > DEPTH_MAX:
            yield f"found more than {DEPTH_MAX} nested levels"
