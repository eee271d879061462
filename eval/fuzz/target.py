"""Target of the fuzzer: a reader, and a folder of files that it reads."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name


def _leave(_: Path) -> None:
    """Leave the files as they are."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A reader of files of unknown origin.

    Attributes:
        make: writes valid files into an empty folder.
        read: reads a folder, one file of which was mutated.
        files: pattern of the files to mutate.
        seal: called after a mutation: renews digests, so that the mutation is not refused as mere damage.
    """

    make: Callable[[Path], object]
    read: Callable[[Path], object]
    files: str = "*"
    seal: Callable[[Path], object] = _leave


Targets = Mapping[str, Target]


def find_targets(table: str) -> Targets:
    """Return a table of targets by the name of its module and itself."""
    targets: Targets = resolve_name(table)
    return targets
