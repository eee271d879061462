"""Bundle of one event: a folder with everything needed to replay it on any machine.

It contains data only. bundle.json lists every file with its SHA-256, every array is checked against the expected
shape before it is read, and nothing is executed except the policy's graph, by the rules for every policy.
"""

import hashlib
import os
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field

from eval.faults.schedule import SECONDS_MAX, FaultSettings
from eval.judge.counts import Event
from eval.judge.monitors import NAMES
from eval.shard.job import code_digest, processor, versions
from robots.errors import ConfigError
from robots.files import is_missing, read_file
from robots.models.files import referenced_files
from robots.spec import RobotSpec
from robots.strict import Strict, parse, read_json_file

INFO, STATE, WINDOW, MCAP = "bundle.json", "state.npz", "window.npz", "window.mcap"
POLICY, DRAWS, ROBOT = "policy.onnx", "draws.json", "robot"
TABLES = ("robot.toml", "draws.toml", "limits.toml")
FILES = (STATE, WINDOW, MCAP, POLICY, DRAWS, *(f"{ROBOT}/{name}" for name in TABLES))
"""Files of every bundle; the robot's model and its meshes are added."""
FILE_BYTES_MAX, BYTES_MAX = 64 << 20, 1 << 29
"""Upper bounds of each file of a bundle, and of all together."""
INFO_CHARACTERS_MAX = 1 << 16

Count = Annotated[int, Field(ge=0, le=1 << 53)]


def _known_monitor(monitor: str) -> str:
    if monitor not in NAMES:
        raise ValueError(f"expected one of {', '.join(NAMES)}")
    return monitor


class EventRecord(Strict):
    """Event as the judge recorded it, at the end of the window.

    Attributes:
        robot: its number in the soak. joint: None for a monitor of the whole robot.
        start, ticks: first bad control tick, and number of ticks from it to the last bad one.
        worst: the highest load, as a fraction of the limit; None if not finite.
        peak: no event, but the tick with the highest load of an attack, bad or not.
    """

    robot: Count
    monitor: Annotated[str, AfterValidator(_known_monitor)]
    joint: str | None
    start: Count
    ticks: Count
    worst: float | None
    peak: Annotated[bool, Field(exclude_if=lambda peak: not peak)] = False

    @classmethod
    def from_event(cls, event: Event, first: int, *, peak: bool = False) -> "EventRecord":
        """Return the record of an event, or of a peak, in the shard whose first robot is `first`."""
        return cls(
            robot=first + event.robot,
            monitor=event.monitor.name,
            joint=event.joint,
            start=event.start,
            ticks=event.ticks,
            worst=event.worst if np.isfinite(event.worst) else None,
            peak=peak,
        )

    def as_text(self) -> dict[str, str]:
        """Return the fields as strings, for the metadata of a recording."""
        return {name: str(value) for name, value in self.model_dump().items()}


class JobRecord(Strict):
    """Job of the event's shard: see `eval.shard.job.ShardJob`."""

    seed: Annotated[int, Field(ge=0)]
    first: Count
    robots: Count
    ticks: Count
    sample_ticks: Annotated[Count, Field(ge=1)]
    faults: FaultSettings | None
    operator_s: Annotated[float | None, Field(ge=0, le=SECONDS_MAX, exclude_if=lambda s: s is None)] = None


class BundleInfo(Strict):
    """Contents of bundle.json.

    Attributes:
        version: of the format.
        identity: everything that the bits depend on, by name.
        begin, end: control ticks: state.npz is before tick `begin`, the window ends before tick `end`.
        end_digest: SHA-256 of the shard's whole state before tick `end`.
        files: SHA-256 by name.
        digest: SHA-256 of all fields above.
    """

    version: Literal[1] = 1
    identity: dict[str, str]
    job: JobRecord
    event: EventRecord
    begin: Count
    end: Count
    end_digest: str
    files: dict[str, str]
    digest: str = ""

    def sealed(self) -> str:
        """Return the correct value of `digest`."""
        return hashlib.sha256(self.model_dump_json(exclude={"digest"}).encode()).hexdigest()


def bundle_name(robot: int, start: int, monitor: str) -> str:
    """Return the folder name of an event: robot's number in the soak, first tick and monitor."""
    return f"{robot:04}-{start:08}-{monitor}"


def robot_files(spec: RobotSpec) -> tuple[str, ...]:
    """Return the files of a robot, relative to its folder: tables, model, and the files that the model names.

    Raises:
        RobotError: the model cannot be read, or a file that it names is missing.
    """
    model = (spec.model_path, *referenced_files(spec.model_path, spec.folder))
    return *TABLES, *(path.relative_to(spec.folder).as_posix() for path in model)


def identity(robot_digest: str, draws_digest: str, policy_digest: str) -> dict[str, str]:
    """Return everything that the bits of a shard depend on, here and now, besides its job."""
    inputs = {"robot_digest": robot_digest, "draws_digest": draws_digest, "policy_digest": policy_digest}
    return {**inputs, "code_digest": code_digest(), **versions(), "processor": processor()}


def seal(folder: Path, info: BundleInfo) -> None:
    """Write bundle.json with the digests of all files in `folder`."""
    files = sorted(path for path in folder.rglob("*") if os.path.isfile(path) and path != folder / INFO)
    digests = {path.relative_to(folder).as_posix(): _digest(path.read_bytes()) for path in files}
    listed = info.model_copy(update={"files": digests})
    complete = listed.model_copy(update={"digest": listed.sealed()})
    (folder / INFO).write_text(complete.model_dump_json(indent=1) + "\n", encoding="utf-8")


def open_bundle(folder: Path) -> BundleInfo:
    """Read bundle.json and check that every file exists and is unchanged.

    Raises:
        ConfigError: naming the file, the field, the value found and the value expected.
    """
    path = folder / INFO
    if is_missing(path):
        raise ConfigError(f"{path}: missing, expected the folder of a bundle")
    info = parse(read_json_file(path, INFO_CHARACTERS_MAX), BundleInfo, source=str(path))
    _check_digest(path, "digest", info.digest, info.sealed())
    _check_names(path, info)
    for name, digest in info.files.items():
        _check_digest(folder / name, "SHA-256", _digest(read_file(folder / name, FILE_BYTES_MAX)), digest)
    if not info.begin <= info.event.start < info.end <= info.job.ticks:
        raise ConfigError(
            f"{path}: found begin {info.begin}, event.start {info.event.start}, end {info.end}, job.ticks"
            f" {info.job.ticks}, expected them in this order"
        )
    return info


def _check_names(path: Path, info: BundleInfo) -> None:
    """All required files are listed, others only below the robot's folder, each by one name, and not too large."""
    for name in sorted({*FILES} - {*info.files}):
        raise ConfigError(f"{path}: files: {name}: missing")
    for name in sorted({*info.files} - {*FILES}):
        parts = PurePosixPath(name).parts
        if parts[:1] != (ROBOT,) or ".." in parts or PurePosixPath(name).as_posix() != name:
            raise ConfigError(f"{path}: files: {name}: unknown")
    places = [path.parent / name for name in info.files]  # several may be links to one file
    if (size := sum(os.path.getsize(place) for place in places if os.path.isfile(place))) > BYTES_MAX:
        raise ConfigError(f"{path}: files: found {size} bytes, expected at most {BYTES_MAX}")


def _check_digest(path: Path, field: str, found: str, expected: str) -> None:
    if found != expected:
        raise ConfigError(f"{path}: {field}: found {found:.12}, expected {expected:.12}: damaged")


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
