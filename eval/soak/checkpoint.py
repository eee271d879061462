"""Checkpoint of a shard on disk, from which an interrupted soak resumes with identical results."""

import json
import os
import zipfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from deploy.stage import Arrays
from deploy.telemetry.output_files import check_folder, replacing
from eval.replay.bundle_files import state_digest
from robots.archives import open_archive
from robots.errors import ConfigError, OutputError, printable
from robots.files import is_missing, read_file

IDENTITY, DIGEST, NAME = "identity", "digest", "shard-{}.npz"
BYTES_MAX = 1 << 29
"""Upper bound of the size of a file: many times that of the longest soak."""
DAMAGED = ".damaged"


class Checkpoint:
    """One file, written whole or not at all, that only the same soak can resume from."""

    def __init__(self, path: Path, identity: Mapping[str, str | int]) -> None:
        """Set the path, and the identity: everything that the arrays depend on."""
        self.path, self.identity = path, dict(identity)

    def store(self, arrays: Arrays) -> None:
        """Replace the stored arrays by `arrays`; the folder must exist.

        Raises:
            OutputError: the file cannot be written, and the stored arrays remain; or the folder was deleted, and a
                new one would hide the loss of its contents; or it is a link, behind which nothing is replaced.
        """
        if not os.path.isdir(self.path.parent):
            raise OutputError(f"{self.path}: cannot be written: {self.path.parent} was deleted")
        if os.path.islink(self.path.parent):
            raise OutputError(f"{self.path}: cannot be written: {self.path.parent} is a link")
        with replacing(self.path) as file, file.open("wb") as stream:
            named: dict[str, Any] = {
                IDENTITY: np.array(json.dumps(self.identity)),
                DIGEST: np.array(state_digest(arrays)),
                **arrays,
            }
            np.savez(stream, **named)
            stream.flush()
            os.fsync(stream.fileno())

    def load(self) -> Arrays | None:
        """Return the stored arrays; None without a file, or if the file is damaged, which is then renamed.

        Raises:
            ConfigError: the file is of another soak, or cannot be read.
            OutputError: a damaged file cannot be renamed.
        """
        if is_missing(self.path):
            return None
        data = read_file(self.path, BYTES_MAX)
        try:
            identity, arrays = _unpack(data)
        except Exception:  # noqa: BLE001 - bytes of unknown origin can fail in any way
            self.set_aside()
            return None
        self._check_identity(identity)
        return arrays

    def set_aside(self) -> None:
        """Rename the file, which is damaged.

        Raises:
            OutputError: it cannot be renamed.
        """
        place = self.path.with_name(self.path.name + DAMAGED)
        try:
            os.replace(self.path, place)
        except OSError as e:
            raise OutputError(
                f"{self.path}: damaged, and cannot be renamed to {place.name}: {e.strerror}"
            ) from e

    def _check_identity(self, found: Mapping[str, str | int]) -> None:
        for key in sorted({*found, *self.identity}):
            if found.get(key) != self.identity.get(key):
                differs = f"{key:.80}: found {found.get(key)!s:.200}, expected {self.identity.get(key)}"
                raise ConfigError(
                    f"{self.path}: {printable(differs)}: it belongs to another soak. Resume that one, give another"
                    f" --out, or delete {self.path.parent}"
                )


def _unpack(data: bytes) -> tuple[dict[str, str | int], Arrays]:
    """Return identity and arrays, which take no more memory than `data`; raise an error if they are not as stored."""
    with open_archive(data, "checkpoint", ConfigError) as archive:
        records = archive.infolist()
    compressed = any(record.compress_type != zipfile.ZIP_STORED for record in records)
    if compressed or sum(record.file_size for record in records) > len(data):
        raise ValueError("the arrays are compressed, or overlap")
    with np.load(BytesIO(data), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    identity = json.loads(str(arrays.pop(IDENTITY)))
    if not isinstance(identity, dict) or str(arrays.pop(DIGEST)) != state_digest(arrays):
        raise ValueError("the arrays are not those that were stored")
    return identity, arrays


def prepare_folder(folder: Path) -> None:
    """Make a folder for checkpoints, and delete partially written ones in it.

    Raises:
        OutputError: nothing can be written there.
    """
    check_folder(folder)
    _delete(folder.glob(f".*.{NAME.format('*')}"))


def delete_checkpoints(folder: Path) -> None:
    """Delete the checkpoints in `folder`, except damaged ones, and the folder if it is empty then; none behind a link.

    Raises:
        OutputError: they cannot be deleted.
    """
    if os.path.islink(folder):
        return
    _delete(folder.glob(NAME.format("*")))
    with suppress(OSError):  # it has other files
        folder.rmdir()


def _delete(files: Iterable[Path]) -> None:
    for file in files:
        try:
            file.unlink()
        except OSError as e:
            raise OutputError(f"{file}: cannot be deleted: {e.strerror}") from e
