"""Output files that are written whole or not at all."""

import os
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from robots.errors import OutputError, output_error


@contextmanager
def replacing(path: Path, option: str = "--out") -> Iterator[Path]:
    """Yield an empty file beside `path`, to be filled; it replaces `path` if the block ends without an error.

    A link stays: the file that it leads to is replaced.

    Raises:
        OutputError: naming the `option`, if the place cannot be written; a `ResultLostError` if the disk has no room.
            An earlier file there is left as it was.
    """
    place = _replaceable(path, option)
    with _partial(place, option) as partial:
        yield partial
        os.replace(partial, place)


def add_file(text: str, path: Path, option: str = "--out") -> bool:
    """Write a file whole or not at all; return False, and write nothing, if there is a file, or a link, already.

    Of several processes, one writes it. On a file system without hard links, the last one may replace the others' file.

    Raises:
        OutputError: as `replacing`.
    """
    if os.path.lexists(path):
        return False
    with _partial(path, option) as partial:
        partial.write_text(text, encoding="utf-8")
        try:
            os.link(partial, path)
        except FileExistsError:
            return False
        except OSError:  # no hard links here
            os.replace(partial, path)
        return True


@contextmanager
def _partial(path: Path, option: str) -> Iterator[Path]:
    """Yield an empty file beside `path`, which is deleted at the end if it is still there."""
    partial = path.with_name(f".{secrets.token_hex(4)}.{path.name}")
    try:
        if not os.path.exists(path.parent):
            path.parent.mkdir(parents=True)
        partial.open("xb").close()
        try:
            yield partial
        finally:
            partial.unlink(missing_ok=True)
    except OSError as e:
        raise output_error(f"{option} {path}: cannot be written: {e.strerror}", e) from e


def check_folder(folder: Path, option: str = "--out") -> None:
    """Make `folder`, and check that files can be made in it.

    Raises:
        OutputError: naming the `option`; a `ResultLostError` if the disk has no room.
    """
    probe = folder / f".{secrets.token_hex(4)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as e:
        reason = "found a link to no folder" if os.path.islink(e.filename or "") else e.strerror
        raise output_error(f"{option} {folder}: cannot be written: {reason}, expected a folder", e) from e


def check_file(path: Path, option: str = "--out") -> None:
    """Check that `replacing` would write a file, before there is any work to lose.

    Raises:
        OutputError: as `replacing`.
    """
    with _partial(_replaceable(path, option), option):
        pass


def check_no_links(out: Path, names: Iterable[str]) -> None:
    """Check that none of the files or folders that a command itself makes in `out`, which may be a link, is one.

    Raises:
        OutputError: what lies behind it is somebody else's, and would be replaced or deleted.
    """
    for path in (out / name for name in names):
        if os.path.islink(path):
            raise OutputError(f"--out {path}: found a link, expected no link")


def check_no_input(path: Path, inputs: Iterable[Path], option: str = "--out") -> None:
    """Check that an output is none of a command's own inputs.

    Raises:
        OutputError: naming the `option`.
    """
    for each in inputs:
        if os.path.exists(path) and os.path.exists(each) and os.path.samefile(path, each):
            raise OutputError(f"{option} {path}: found a file that is read, expected another place")


def _replaceable(path: Path, option: str) -> Path:
    """Return the place of a file that may be replaced, if there is one: for a link, that of the file behind it."""
    if not path.name:
        raise OutputError(f"{option} {path}: found a folder, expected a file or nothing")
    if os.path.exists(path) and not os.path.isfile(path):
        raise OutputError(f"{option} {path}: found a folder or a device, expected a file or nothing")
    if os.path.exists(path) and not os.access(path, os.W_OK):
        raise OutputError(
            f"{option} {path}: found a write-protected file, expected a writable one or nothing"
        )
    if not os.path.islink(path):
        return path
    place = Path(os.path.realpath(path))
    if not os.path.isfile(place):  # a loop, or a file that was deleted while a process has it open
        raise OutputError(f"{option} {path}: found a link to no file, expected a file or nothing")
    return place
