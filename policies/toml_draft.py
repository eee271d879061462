"""TOML drafts for a person to complete: known values, "?" for the others, and a description of each."""

from collections.abc import Mapping
from typing import Any, TypeVar

import tomlkit
from tomlkit.items import Table

from robots.strict import PLACEHOLDER

Part = TypeVar("Part", tomlkit.TOMLDocument, Table)


def commented_document(head: str) -> tomlkit.TOMLDocument:
    """Return a document that begins with these lines as comments."""
    document = tomlkit.document()
    for line in head.splitlines():
        document.add(tomlkit.comment(line))
    return document


def fill(part: Part, known: Mapping[str, Any], descriptions: Mapping[str, str]) -> Part:
    """Add the described keys, "?" for those not known, then the other known keys; None counts as not known."""
    values = dict.fromkeys(descriptions, PLACEHOLDER) | {k: v for k, v in known.items() if v is not None}
    for key, value in values.items():
        item = tomlkit.item(value)
        if key in descriptions:
            item.comment(descriptions[key])
        part.add(key, item)
    return part
