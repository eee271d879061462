"""Installed plug-ins, found by group and name through the entry points of the Python environment."""

import sys
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Any

from robots.errors import ConfigError

BACKENDS, TASKS = "firstshift.backends", "firstshift.tasks"
"""Groups of entry points: robot backends, and tasks of a policy."""


def installed(group: str) -> Mapping[str, EntryPoint]:
    """Return the entry points of a group by name, sorted and not imported.

    Raises:
        ConfigError: two installed distributions claim the same name.
    """
    return _scan(group, tuple(sys.path))


def load(group: str, name: str, origin: str) -> Any:
    """Import the plug-in `name` of a group and return the object that its entry point names.

    Names are looked up among installed ones only, so that they may come from an untrusted file.

    Raises:
        ConfigError: beginning with `origin`, an option or a field with its value: the name is unknown, or a module that
            the plug-in imports is missing.
    """
    known = installed(group)
    if name not in known:
        raise ConfigError(f"{origin}: unknown; known: {', '.join(known)}")
    try:
        return known[name].load()
    except (ImportError, AttributeError) as e:
        entry, owner = known[name], known[name].dist
        extras = f"; pip extra: {owner.name}[{','.join(entry.extras)}]" if owner and entry.extras else ""
        raise ConfigError(f"{origin}: {entry.module} cannot be imported: {e}{extras}") from e


@lru_cache
def _scan(group: str, _path: tuple[str, ...]) -> Mapping[str, EntryPoint]:
    found: dict[str, EntryPoint] = {}
    for entry in sorted(entry_points(group=group)):
        if entry.name in found:
            raise ConfigError(f"{group}: {entry.name}: found {found[entry.name].value} and {entry.value}")
        found[entry.name] = entry
    return MappingProxyType(found)
