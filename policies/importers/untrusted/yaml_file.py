"""YAML of unknown origin: plain data of a bounded size; no tags of anybody's own, nothing that stands for another."""

from pathlib import Path

from robots.errors import ContractError

CHARACTERS_MAX = 1 << 18
DEPTH_MAX = 20


def read_yaml(path: Path) -> object:
    """What a file holds.

    Raises:
        ContractError: it cannot be read, is too long, is no plain YAML, or names parts of itself.
    """
    import yaml

    try:
        with path.open(encoding="utf-8") as stream:
            text = stream.read(CHARACTERS_MAX + 1)
        if len(text) > CHARACTERS_MAX:
            raise ContractError(f"{path}: found more than {CHARACTERS_MAX} characters, expected a descriptor")
        depth = 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if isinstance(event, yaml.AliasEvent):  # a few can stand for more than there is memory
                found = f"line {event.start_mark.line + 1}: found the alias {event.anchor!r:.100}"
                raise ContractError(f"{path}: {found}, expected each value in full")
            if depth > DEPTH_MAX:
                raise ContractError(f"{path}: found more than {DEPTH_MAX} parts inside each other")
        return yaml.safe_load(text)
    except OSError as e:
        raise ContractError(f"{path}: cannot be read: {e.strerror}") from e
    except (yaml.YAMLError, ValueError, RecursionError) as e:
        said = " ".join(str(getattr(e, "problem", None) or type(e).__name__).split())
        raise ContractError(f"{path}: not valid YAML: {said:.200}") from e
