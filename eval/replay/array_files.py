"""Array files of a bundle: deterministic npz, and reading that checks names, shapes and dtypes first."""

import hashlib
import io
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deploy.stage import Arrays
from robots.errors import ConfigError

READ_ERRORS = OSError, ValueError, EOFError, KeyError, RuntimeError, zipfile.BadZipFile, zlib.error


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
        with zipfile.ZipFile(path) as file:
            found = {name.removesuffix(".npy") for name in file.namelist()}
            for name in sorted(found ^ expected.keys()):
                raise ConfigError(f"{path}: {name:.80}: {'unknown' if name in found else 'missing'}")
            return {name: _array(file, f"{path}: {name}", name, like) for name, like in expected.items()}
    except READ_ERRORS as e:
        raise ConfigError(f"{path}: cannot be read: {' '.join(str(e).split()):.200}") from e


def _array(file: zipfile.ZipFile, where: str, name: str, like: NDArray[np.generic]) -> NDArray[np.generic]:
    """One array; its header must describe `like`."""
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
