"""A shard on disk: what it has lived through, from where a soak that was cut short goes on as if it had not been."""

import json
import os
import zipfile
from collections.abc import Iterable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from deploy.stage import Arrays
from deploy.telemetry.output_files import replacing
from robots.errors import ConfigError, OutputError

IDENTITY, SUFFIX = "identity", ".npz"
DAMAGED = ".damaged"
DAMAGE = TypeError, ValueError, KeyError, EOFError, NotImplementedError, RuntimeError, zipfile.BadZipFile
"""What numpy, zipfile and json make of a file that is no longer what was written."""


class Checkpoint:
    """One file, written whole or not at all, that goes on with nothing but the very same soak."""

    def __init__(self, path: Path, identity: Mapping[str, str | int]) -> None:
        """Name the file and everything on which its arrays depend."""
        self.path, self._identity = path, dict(identity)

    def store(self, arrays: Arrays) -> None:
        """Put `arrays` in the place of what was stored before, in a folder that is there.

        Raises:
            OutputError: the place cannot be written; what was stored before is there still. Or its folder is gone: a
                new one would hide that what was in it is lost.
        """
        if not os.path.isdir(self.path.parent):
            raise OutputError(f"{self.path}: cannot be written: {self.path.parent} is gone")
        with replacing(self.path) as file, file.open("wb") as stream:
            named: dict[str, Any] = {IDENTITY: np.array(json.dumps(self._identity)), **arrays}
            np.savez(stream, **named)
            stream.flush()
            os.fsync(stream.fileno())

    def load(self) -> Arrays | None:
        """What was stored last; None where there is nothing, or what is damaged and set aside under another name.

        Raises:
            ConfigError: it is of another soak, or cannot be read.
            OutputError: a damaged one cannot be set aside.
        """
        try:
            data = self.path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as e:
            raise ConfigError(f"{self.path}: cannot be read: {e.strerror}") from e
        try:
            identity, arrays = _unpacked(data)
        except DAMAGE:
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


def _unpacked(data: bytes) -> tuple[dict[str, str | int], Arrays]:
    with np.load(BytesIO(data), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    return dict(json.loads(str(arrays.pop(IDENTITY)))), arrays


def make(folder: Path) -> None:
    """Make a folder for shards, and clear away what was left half written in it.

    Raises:
        OutputError: nothing can be written there.
    """
    probe = folder / f".probe{SUFFIX}"
    with replacing(probe):
        pass
    _delete(folder.glob(f".*{SUFFIX}"))


def clear(folder: Path) -> None:
    """Delete what is kept in `folder`, but for what was set aside.

    Raises:
        OutputError: it cannot be deleted.
    """
    _delete(folder.glob(f"*{SUFFIX}"))
    if folder.exists() and not any(folder.iterdir()):
        folder.rmdir()


def _delete(files: Iterable[Path]) -> None:
    for file in files:
        try:
            file.unlink()
        except OSError as e:
            raise OutputError(f"{file}: cannot be deleted: {e.strerror}") from e
