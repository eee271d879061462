"""A shard on disk: what it has lived through, from where a soak that was cut short goes on as if it had not been."""

import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deploy.output import replacing
from deploy.stage import Arrays
from robots.errors import ConfigError, OutputError

IDENTITY, SUFFIX = "identity", ".npz"
DAMAGED = ".damaged"


class Checkpoint:
    """One file, written whole or not at all, that goes on with nothing but the very same soak."""

    def __init__(self, path: Path, identity: Mapping[str, str | int]) -> None:
        """Name the file and everything on which its arrays depend."""
        self.path, self._identity = path, dict(identity)

    def store(self, arrays: Arrays) -> None:
        """Put `arrays` in the place of what was stored before.

        Raises:
            OutputError: the place cannot be written; what was stored before is there still.
        """
        with replacing(self.path) as file, file.open("wb") as stream:
            named: dict[str, Any] = {IDENTITY: np.array(json.dumps(self._identity)), **arrays}
            np.savez(stream, **named)
            stream.flush()
            os.fsync(stream.fileno())

    def load(self) -> Arrays | None:
        """What was stored last; None where there is nothing, or what is damaged and set aside under another name.

        Raises:
            ConfigError: it is of another soak.
            OutputError: a damaged one cannot be set aside.
        """
        if not self.path.exists():
            return None
        try:
            with self.path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                identity = json.loads(str(file[IDENTITY]))
                arrays = {name: file[name] for name in file.files if name != IDENTITY}
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            self._set_aside()
            return None
        self._compare(identity)
        return arrays

    def _compare(self, found: Mapping[str, str | int]) -> None:
        for key in sorted({*found, *self._identity}):
            if found.get(key) != self._identity.get(key):
                raise ConfigError(
                    f"{self.path}: {key}: found {found.get(key)}, expected {self._identity.get(key)}: the beginning of"
                    f" another soak. Go on with that one, give another --out, or delete {self.path.parent}"
                )

    def _set_aside(self) -> None:
        place = self.path.with_name(self.path.name + DAMAGED)
        try:
            os.replace(self.path, place)
        except OSError as e:
            raise OutputError(
                f"{self.path}: damaged, and cannot be set aside as {place.name}: {e.strerror}"
            ) from e


def clear(folder: Path) -> None:
    """Delete what is kept in `folder`, but for what was set aside."""
    for file in folder.glob(f"*{SUFFIX}"):
        file.unlink()
    if folder.exists() and not any(folder.iterdir()):
        folder.rmdir()
