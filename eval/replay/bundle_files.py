"""Files of bundles: deterministic npz arrays, checked by name, shape and dtype before reading; folders of bundles."""

import hashlib
import io
import os
import secrets
import shutil
import zipfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deploy.stage import Arrays
from eval.replay.bundle import FILE_BYTES_MAX, INFO, ROBOT
from robots.archives import open_archive
from robots.errors import ConfigError, OutputError, output_error
from robots.files import read_file


def state_digest(arrays: Mapping[str, NDArray[np.generic]]) -> str:
    """Return the SHA-256 of arrays: their names, dtypes, shapes and bits."""
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays as npz; equal arrays give equal bytes."""
    with zipfile.ZipFile(path, "w") as file:
        for name, array in sorted(arrays.items()):
            stream = io.BytesIO()
            np.lib.format.write_array(stream, np.asanyarray(array), allow_pickle=False)
            # A ZipInfo without a date, so that the bytes do not depend on the time.
            file.writestr(zipfile.ZipInfo(f"{name}.npy"), stream.getvalue(), zipfile.ZIP_DEFLATED)


def read_arrays(path: Path, expected: Mapping[str, NDArray[np.generic]]) -> Arrays:
    """Read a file of `write_arrays` whose names, shapes and dtypes are those of `expected`.

    Raises:
        ConfigError: naming the file and the array; no array larger than expected is allocated.
    """
    try:
        with open_archive(read_file(path, FILE_BYTES_MAX), str(path), ConfigError) as file:
            found = {name.removesuffix(".npy") for name in file.namelist()}
            for name in sorted(found ^ expected.keys()):
                raise ConfigError(f"{path}: {name:.80}: {'unknown' if name in found else 'missing'}")
            return {name: _array(file, f"{path}: {name}", name, like) for name, like in expected.items()}
    except ConfigError:
        raise
    except Exception as e:  # bytes of unknown origin can fail in any way
        raise ConfigError(f"{path}: cannot be read: {' '.join(str(e).split()):.200}") from e


def _array(file: zipfile.ZipFile, where: str, name: str, like: NDArray[np.generic]) -> NDArray[np.generic]:
    with file.open(f"{name}.npy") as stream:
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):
            raise ConfigError(f"{where}: found npy version {version}, expected (1, 0)")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
        if (shape, dtype, fortran) != (like.shape, like.dtype, False):
            raise ConfigError(f"{where}: found {dtype} {shape}, expected {like.dtype} {like.shape}")
        data = stream.read(like.nbytes + 1)
    if len(data) != like.nbytes:
        raise ConfigError(f"{where}: found another size than {like.nbytes} bytes")
    return np.frombuffer(data, dtype=dtype).reshape(shape)


@contextmanager
def new_bundle(path: Path) -> Iterator[Path]:
    """Yield an empty temporary folder to fill; it replaces `path` when the block ends without an error.

    The parent of `path` is made where it is missing, but not the parent's parent.

    Raises:
        OutputError: the folder cannot be written, or its parent is a link, behind which nothing is replaced.
    """
    if os.path.islink(path.parent):
        raise OutputError(f"{path}: cannot be written: {path.parent} is a link")
    partial = path.with_name(f".{secrets.token_hex(4)}.{path.name}")
    try:
        path.parent.mkdir(exist_ok=True)
        (partial / ROBOT).mkdir(parents=True)
        try:
            yield partial
            if os.path.exists(path):
                _remove(path)
            partial.rename(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as e:
        raise output_error(f"{path}: cannot be written: {e.strerror}", e) from e


def list_bundles(folder: Path) -> list[str]:
    """Return the bundles in `folder`, relative to its parent."""
    return sorted(f"{folder.name}/{info.parent.name}" for info in folder.glob(f"[!.]*/{INFO}"))


def delete_bundles(folder: Path, *, finished: bool) -> None:
    """Delete partially written bundles in `folder`, and finished ones if asked; none behind a link.

    Raises:
        OutputError: they cannot be deleted.
    """
    if os.path.islink(folder):
        return
    partial = {path.parent for path in folder.glob(f".*/{ROBOT}")}
    complete = {path.parent for path in folder.glob(f"*/{INFO}") if finished}
    try:
        for path in partial | complete:
            _remove(path)
    except OSError as e:
        raise OutputError(f"{path}: cannot be deleted: {e.strerror}") from e


def _remove(folder: Path) -> None:
    """Remove a folder, or a link to one."""
    if os.path.islink(folder):
        folder.unlink()
    else:
        shutil.rmtree(folder)


def copy_bundles(source: Path, place: Path, names: Collection[str] | None = None) -> None:
    """Replace the bundles in `place` by copies of those in `source`, all or those of some names.

    Raises:
        OutputError: they cannot be written.
    """
    delete_bundles(place, finished=True)
    for bundle in {info.parent for info in source.glob(f"[!.]*/{INFO}")}:
        if names is None or bundle.name in names:
            with new_bundle(place / bundle.name) as partial:
                for path in bundle.rglob("*"):
                    _copy(path, partial / path.relative_to(bundle))


def _copy(source: Path, place: Path) -> None:
    """Make a folder, or a hard link to a file; on a file system without them, copy the file."""
    if os.path.isdir(source):
        place.mkdir(exist_ok=True)
        return
    try:
        os.link(source, place)
    except OSError:
        shutil.copyfile(source, place)


def remove_bundles(folder: Path) -> None:
    """Delete the bundles in `folder`, and it and its parents as far as they are empty then.

    Raises:
        OutputError: they cannot be deleted.
    """
    delete_bundles(folder, finished=True)
    with suppress(OSError):
        os.removedirs(folder)
