"""Kernels: scalar code over the rows of robots, compiled by numba.

A kernel is written as a textbook has it, for one robot or one joint, inside loops over arrays. Its types are declared,
so that it is compiled when its module is imported and never again: an argument of another type raises TypeError, where
numba would otherwise compile for a second while a robot moves. An index outside of an array raises IndexError.

Compiled code is kept in `__pycache__` beside this module, or in the user's cache folder, in a folder of its own for
each version of this file, of the kernel's file and of the compiler: constants and inlined functions of a kernel are
therefore of its own file. Where neither place can be written, it is compiled at every start.

Nothing is reordered or contracted: a kernel gives the bits of the same code without compilation, which runs with
`NUMBA_DISABLE_JIT=1`.
"""

import hashlib
import os
import shutil
from collections.abc import Callable
from contextlib import chdir, nullcontext
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

SETTINGS = ".numba_config.yaml"
"""Name of a file of settings, a cache folder among them, that numba reads in the working directory, which may be a
robot's folder that somebody else has written: at its import, and again when it compiles."""
with chdir("/") if os.path.lexists(SETTINGS) else nullcontext():
    import numba
numba.core.config._config_fname = os.devnull  # it reads regular files only

BOOL, INT, FLOAT = numba.boolean, numba.int64, numba.float64
Function = TypeVar("Function", bound=Callable[..., Any])

_OPTIONS = {"error_model": "numpy", "boundscheck": True}
"""A division by zero is infinite or not a number, as in arrays; no memory outside of an array is read."""
_COMPILER = f"{version('numba')} {version('llvmlite')}"


def array(of: Any, dimensions: int, *, written: bool = False) -> Any:
    """Return the type of an array of any strides; one that is not `written` may also be read-only.

    Args:
        of: `BOOL`, `INT`, `FLOAT` or a structured dtype.
        dimensions: of the array.
        written: the kernel writes into it.
    """
    element = of if isinstance(of, numba.types.Type) else numba.from_dtype(of)
    return numba.types.Array(element, dimensions, "A", readonly=not written)


def alike(of: Any, count: int) -> Any:
    """Return the type of a tuple of `count` values of one type."""
    return numba.types.UniTuple(of, count)


def kernel(*arguments: Any) -> Callable[[Function], Function]:
    """Compile a function for arguments of these types, or of the type of a named tuple that stands for its type."""
    types = tuple(numba.typeof(each) if isinstance(each, tuple) else each for each in arguments)

    def compile_now(function: Function) -> Function:
        folder = _cache_folder(function)
        if folder is None:
            return numba.njit([types], **_OPTIONS)(function)  # type: ignore[no-any-return]
        numba.config.CACHE_DIR = str(folder)
        try:
            return numba.njit([types], cache=True, **_OPTIONS)(function)  # type: ignore[no-any-return]
        except Exception:  # noqa: BLE001
            # Any error of a cache that is damaged or on a full disk. One of the code is raised again here.
            shutil.rmtree(folder, ignore_errors=True)
            return numba.njit([types], **_OPTIONS)(function)  # type: ignore[no-any-return]

    return compile_now


def inlined(function: Function) -> Function:
    """Compile a function as a part of the kernels in the same file that call it."""
    return numba.njit(**_OPTIONS)(function)  # type: ignore[no-any-return]


def _cache_folder(function: Callable[..., Any]) -> Path | None:
    """Return a folder for the compiled code of a kernel, which no other source shares; None if none can be made.

    It is never relative: the working directory may hold somebody else's files, and a cache is code.
    """
    digest = hashlib.sha256(_COMPILER.encode())
    for file in (__file__, function.__code__.co_filename):
        digest.update(Path(file).read_bytes())
    home = Path(os.path.expanduser("~"))
    for parent in (Path(__file__).resolve().parent / "__pycache__", home / ".cache" / "firstshift"):
        folder = parent / f"kernels-{digest.hexdigest()[:16]}"
        try:
            if parent.is_absolute():
                folder.mkdir(parents=True, exist_ok=True)
                if os.access(folder, os.W_OK):
                    return folder
        except OSError:
            continue
    return None
