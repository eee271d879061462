"""One event to take away: a folder with all that it takes to live it again, here or elsewhere.

It holds data only. Every file is listed with its digest, every array is compared with the one that it takes the place
of before it is read, and nothing in it is executed but the policy's graph, by the rules of every policy.
"""

import hashlib
import io
import os
import secrets
import shutil
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from deploy.stage import Arrays
from eval.judge.counts import Event
from eval.judge.monitors import NAMES
from eval.soak.fingerprint import code_digest, processor, versions
from eval.soak.profile import Faults
from robots.errors import ConfigError, OutputError
from robots.models.files import referenced_files
from robots.spec import RobotSpec
from robots.strict import Strict, parse, read_json

ABOUT, STATE, WINDOW, MCAP = "bundle.json", "state.npz", "window.npz", "window.mcap"
POLICY, DRAWS, ROBOT = "policy.onnx", "draws.json", "robot"
TABLES = ("robot.toml", "draws.toml", "limits.toml")
FILES = (STATE, WINDOW, MCAP, POLICY, DRAWS, *(f"{ROBOT}/{name}" for name in TABLES))
"""Of every bundle; beside them lie the robot's model and what that names."""
FILE_BYTES_MAX = 64 << 20
"""Of each file of a bundle."""
ABOUT_CHARACTERS_MAX = 1 << 16

Count = Annotated[int, Field(ge=0, le=1 << 53)]


def _known(monitor: str) -> str:
    if monitor not in NAMES:
        raise ValueError(f"expected one of {', '.join(NAMES)}")
    return monitor


class Happened(Strict):
    """What the judge saw, as it stood at the end of the window.

    Attributes:
        robot: its number in the soak. joint: None for a monitor of the whole robot.
        start, ticks: first bad control tick, and how many from it to the last bad one.
        worst: the highest load, a fraction of the limit; None where it was no number.
    """

    robot: Count
    monitor: Annotated[str, AfterValidator(_known)]
    joint: str | None
    start: Count
    ticks: Count
    worst: float | None

    @classmethod
    def of(cls, event: Event, first: int) -> "Happened":
        """An event of the shard whose first robot is `first`."""
        return cls(
            robot=first + event.robot,
            monitor=event.monitor.name,
            joint=event.joint,
            start=event.start,
            ticks=event.ticks,
            worst=event.worst if np.isfinite(event.worst) else None,
        )

    def said(self) -> dict[str, str]:
        """For readers of a recording."""
        return {name: str(value) for name, value in self.model_dump().items()}


class Job(Strict):
    """Of the shard that lived it: see `eval.soak.shard.ShardJob`."""

    seed: Annotated[int, Field(ge=0)]
    first: Count
    robots: Count
    ticks: Count
    sample_ticks: Annotated[Count, Field(ge=1)]
    faults: Faults | None


class About(Strict):
    """bundle.json.

    Attributes:
        version: of this layout.
        identity: what the bits depend on, by name.
        begin, end: control ticks: state.npz is before tick `begin`, the window ends before tick `end`.
        end_digest: of the shard's whole state before tick `end`.
        files: SHA-256 by name.
        digest: SHA-256 of all the above.
    """

    version: Literal[1] = 1
    identity: dict[str, str]
    job: Job
    event: Happened
    begin: Count
    end: Count
    end_digest: str
    files: dict[str, str]
    digest: str = ""

    def sealed(self) -> str:
        """What `digest` must be."""
        return hashlib.sha256(self.model_dump_json(exclude={"digest"}).encode()).hexdigest()


def bundle_name(robot: int, start: int, monitor: str) -> str:
    """The folder of an event: by the robot's number in the soak, its first tick and its monitor."""
    return f"{robot:04}-{start:08}-{monitor}"


def robot_files(spec: RobotSpec) -> tuple[str, ...]:
    """What it takes to read a robot again, by place in its folder: its tables, its model, and what that names.

    Raises:
        RobotError: the model cannot be read, or it names what is not there.
    """
    model = (spec.model_path, *referenced_files(spec.model_path, spec.folder))
    return *TABLES, *(path.relative_to(spec.folder).as_posix() for path in model)


def identity(robot_digest: str, draws_digest: str, policy_digest: str) -> dict[str, str]:
    """What the bits of a shard depend on here and now, beside its job."""
    own = {"robot_digest": robot_digest, "draws_digest": draws_digest, "policy_digest": policy_digest}
    return {**own, "code_digest": code_digest(), **versions(), "processor": processor()}


def state_digest(arrays: Mapping[str, NDArray[np.generic]]) -> str:
    """SHA-256 of arrays: their names, kinds, shapes and bits."""
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


@contextmanager
def filling(place: Path) -> Iterator[Path]:
    """An empty folder beside `place`, to be filled; it takes the place of `place` when the block ends well.

    Only the folder of bundles is made where it is missing, not the one that it lies in.

    Raises:
        OutputError: the place cannot be written.
    """
    partial = place.with_name(f".{secrets.token_hex(4)}.{place.name}")
    try:
        place.parent.mkdir(exist_ok=True)
        (partial / ROBOT).mkdir(parents=True)
        try:
            yield partial
            if place.exists():
                shutil.rmtree(place)
            partial.rename(place)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as e:
        raise OutputError(f"{place}: cannot be written: {e.strerror}") from e


def clear_bundles(folder: Path, *, all_of_them: bool) -> None:
    """Delete the bundles in `folder`, or only those that a soak that was cut short left unfinished.

    Raises:
        OutputError: they cannot be deleted.
    """
    unfinished = {place.parent for place in folder.glob(f".*/{ROBOT}")}
    whole = {place.parent for place in folder.glob(f"*/{ABOUT}") if all_of_them}
    try:
        for place in unfinished | whole:
            shutil.rmtree(place)
    except OSError as e:
        raise OutputError(f"{place}: cannot be deleted: {e.strerror}") from e


def move_bundles(source: Path, place: Path) -> None:
    """Put the bundles in `source` in the place of those in `place`; what is empty then goes.

    Raises:
        OutputError: they cannot be moved.
    """
    clear_bundles(place, all_of_them=True)
    try:
        for about in source.glob(f"*/{ABOUT}"):
            place.mkdir(exist_ok=True)
            about.parent.rename(place / about.parent.name)
    except OSError as e:
        raise OutputError(f"{place}: cannot be written: {e.strerror}") from e
    with suppress(OSError):
        os.removedirs(source)


def bundles(folder: Path) -> list[str]:
    """Of the bundles in `folder`, that a report beside it can be told of: their places as seen from the report."""
    return sorted(f"{folder.name}/{about.parent.name}" for about in folder.glob(f"[!.]*/{ABOUT}"))


def seal(folder: Path, about: About) -> None:
    """Write bundle.json, with the digests of the files that `folder` holds."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path != folder / ABOUT)
    digests = {path.relative_to(folder).as_posix(): _digest(path.read_bytes()) for path in files}
    listed = about.model_copy(update={"files": digests})
    whole = listed.model_copy(update={"digest": listed.sealed()})
    (folder / ABOUT).write_text(whole.model_dump_json(indent=1) + "\n", encoding="utf-8")


def open_bundle(folder: Path) -> About:
    """Read bundle.json and see that every file is there and what it was.

    Raises:
        ConfigError: naming the file, the field, what was found and what was expected.
    """
    path = folder / ABOUT
    text = _read(path, ABOUT_CHARACTERS_MAX).decode("utf-8", errors="replace")
    about = parse(read_json(text, str(path), ABOUT_CHARACTERS_MAX), About, source=str(path))
    _same(path, "digest", about.digest, about.sealed())
    for name in sorted({*FILES} - {*about.files}):
        raise ConfigError(f"{path}: files: {name}: missing")
    for name in sorted({*about.files} - {*FILES}):
        place = PurePosixPath(name)
        if place.parts[:1] != (ROBOT,) or ".." in place.parts:
            raise ConfigError(f"{path}: files: {name}: unknown")
    for name, digest in about.files.items():
        _same(folder / name, "SHA-256", _digest(_read(folder / name, FILE_BYTES_MAX)), digest)
    if not about.begin <= about.event.start < about.end <= about.job.ticks:
        raise ConfigError(
            f"{path}: found begin {about.begin}, event.start {about.event.start}, end {about.end}, job.ticks"
            f" {about.job.ticks}, expected them in this order"
        )
    return about


def _same(path: Path, field: str, found: str, expected: str) -> None:
    if found != expected:
        raise ConfigError(f"{path}: {field}: found {found:.12}, expected {expected:.12}: damaged")


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _read(path: Path, bytes_max: int) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(bytes_max + 1)
    except OSError as e:
        raise ConfigError(f"{path}: cannot be read: {e.strerror}, expected a file of a bundle") from e
    if len(data) > bytes_max:
        raise ConfigError(f"{path}: found more than {bytes_max} bytes, expected at most that")
    return data


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Store arrays as numpy's npz does, the same bytes whenever and wherever it is done."""
    with zipfile.ZipFile(path, "w") as file:
        for name, array in sorted(arrays.items()):
            stream = io.BytesIO()
            np.lib.format.write_array(stream, np.asanyarray(array), allow_pickle=False)
            # A member that is named so has no date.
            file.writestr(zipfile.ZipInfo(f"{name}.npy"), stream.getvalue(), zipfile.ZIP_DEFLATED)


def read_arrays(path: Path, expected: Mapping[str, NDArray[np.generic]]) -> Arrays:
    """What `write_arrays` stored, if its names, shapes and kinds are those of `expected`.

    Raises:
        ConfigError: naming the file and the array; nothing larger than expected is ever made.
    """
    try:
        with zipfile.ZipFile(path) as file:
            found = {name.removesuffix(".npy") for name in file.namelist()}
            for name in sorted(found ^ expected.keys()):
                raise ConfigError(f"{path}: {name:.80}: {'unknown' if name in found else 'missing'}")
            return {name: _array(file, f"{path}: {name}", name, like) for name, like in expected.items()}
    except (
        OSError,
        ValueError,
        EOFError,
        KeyError,
        RuntimeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as e:
        raise ConfigError(f"{path}: cannot be read: {' '.join(str(e).split()):.200}") from e


def _array(file: zipfile.ZipFile, where: str, name: str, like: NDArray[np.generic]) -> NDArray[np.generic]:
    """One array; its header is believed only where it says what is expected."""
    with file.open(f"{name}.npy") as stream:
        version = np.lib.format.read_magic(stream)
        if version != (1, 0):
            raise ConfigError(f"{where}: found npy version {version}, expected (1, 0)")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
        if (shape, dtype, fortran) != (like.shape, like.dtype, False):
            raise ConfigError(f"{where}: found {dtype} {shape}, expected {like.dtype} {like.shape}")
        data = stream.read(like.nbytes + 1)
    if len(data) != like.nbytes:
        raise ConfigError(f"{where}: found other than its {like.nbytes} bytes")
    return np.frombuffer(data, dtype=dtype).reshape(shape)
