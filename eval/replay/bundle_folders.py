"""Folders of bundles: fill, list, delete and replace them."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from eval.replay.bundle import INFO, ROBOT
from robots.errors import OutputError


@contextmanager
def new_bundle(path: Path) -> Iterator[Path]:
    """Yield an empty temporary folder to fill; it replaces `path` when the block ends without an error.

    The parent of `path` is made where it is missing, but not the parent's parent.

    Raises:
        OutputError: the folder cannot be written.
    """
    partial = path.with_name(f".{secrets.token_hex(4)}.{path.name}")
    try:
        path.parent.mkdir(exist_ok=True)
        (partial / ROBOT).mkdir(parents=True)
        try:
            yield partial
            if path.exists():
                shutil.rmtree(path)
            partial.rename(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as e:
        raise OutputError(f"{path}: cannot be written: {e.strerror}") from e


def list_bundles(folder: Path) -> list[str]:
    """Return the bundles in `folder`, relative to its parent."""
    return sorted(f"{folder.name}/{info.parent.name}" for info in folder.glob(f"[!.]*/{INFO}"))


def delete_bundles(folder: Path, *, finished: bool) -> None:
    """Delete partially written bundles in `folder`, and finished ones if asked.

    Raises:
        OutputError: they cannot be deleted.
    """
    partial = {path.parent for path in folder.glob(f".*/{ROBOT}")}
    complete = {path.parent for path in folder.glob(f"*/{INFO}") if finished}
    try:
        for path in partial | complete:
            shutil.rmtree(path)
    except OSError as e:
        raise OutputError(f"{path}: cannot be deleted: {e.strerror}") from e


def replace_bundles(source: Path, place: Path) -> None:
    """Replace the bundles in `place` by those in `source`; remove empty folders.

    Raises:
        OutputError: they cannot be moved.
    """
    delete_bundles(place, finished=True)
    try:
        for info in source.glob(f"*/{INFO}"):
            place.mkdir(exist_ok=True)
            info.parent.rename(place / info.parent.name)
    except OSError as e:
        raise OutputError(f"{place}: cannot be written: {e.strerror}") from e
    with suppress(OSError):
        os.removedirs(source)
