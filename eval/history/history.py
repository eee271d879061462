"""History: a folder with a record of each finished soak, never overwritten; pooling and comparison of records."""

import os
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC
from itertools import count
from pathlib import Path

from deploy.telemetry.output_files import add_file
from eval.history.soak_record import Settings, SoakRecord
from eval.statistics.per_draw_counts import PerDrawCounts, concatenate
from robots.errors import ConfigError
from robots.strict import parse, read_json_file

SUFFIX = ".soak.json"
CHARACTERS_MAX = 1 << 26
"""Upper bound of the size of a record, 200 for each robot, or report, 500."""
RECORDS_MAX, BYTES_MAX, DRAWS_MAX = 1 << 12, 1 << 28, 1 << 20
"""Upper bounds of a history: eleven years of nights, each with 256 robots."""


def add_record(record: SoakRecord, folder: Path) -> Path:
    """Write the fields of `SoakRecord`, without the rest of a report, to a new file and return its path.

    Raises:
        OutputError: it cannot be written.
    """
    text = record.model_dump_json(include={*SoakRecord.model_fields}, indent=1)
    return next(path for path in _names(record, folder) if add_file(text, path, option="--history"))


def _names(record: SoakRecord, folder: Path) -> Iterator[Path]:
    """Candidate paths: start time and seed, then with a number for soaks that began in the same second."""
    name = f"{record.run.moment.astimezone(UTC):%Y%m%dT%H%M%SZ}-seed{record.settings.seed}"
    yield folder / f"{name}{SUFFIX}"
    yield from (folder / f"{name}-{number}{SUFFIX}" for number in count(2))


def record_files(folder: Path) -> list[Path]:
    """Return the files of records in `folder`, sorted; none if there is no such folder.

    Raises:
        ConfigError: it cannot be read, or there are too many.
    """
    try:
        names = os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as e:
        raise ConfigError(f"{folder}: cannot be read: {e.strerror}") from e
    paths = [folder / name for name in sorted(names) if name.endswith(SUFFIX) and not name.startswith(".")]
    size = sum(map(_size, paths))
    for found, most, unit in ((len(paths), RECORDS_MAX, "records"), (size, BYTES_MAX, "bytes of records")):
        if found > most:
            raise ConfigError(f"{folder}: found {found} {unit}, expected at most {most}: move old ones away")
    return paths


def _size(path: Path) -> int:
    """Return the size of a file, bytes; 0 if it cannot be read, which `read_record` reports."""
    try:
        return os.path.getsize(path)
    except OSError:
        return 0


def read_history(folder: Path) -> dict[str, SoakRecord]:
    """Return the records in `folder` by file name, in the order of their start.

    Raises:
        ConfigError: a file cannot be read, was edited, or has another task than the first.
    """
    records = {str(path): read_record(path) for path in record_files(folder)}
    if (draws := sum(record.per_draw_counts.draws for record in records.values())) > DRAWS_MAX:
        raise ConfigError(f"{folder}: found {draws} draws, expected at most {DRAWS_MAX}: move old ones away")
    by_time = dict(sorted(records.items(), key=lambda item: item[1].run.moment))
    if by_time:
        name, first = next(iter(by_time.items()))
        check_same_task(by_time, first.settings, name)
    return by_time


def check_same_task(records: Mapping[str, SoakRecord], settings: Settings, name: str) -> None:
    """Check that the task of every record is that of `settings`, which belong to `name`.

    Raises:
        ConfigError: naming the file and the first field that differs.
    """
    for path, record in records.items():
        check_same_identity(settings.task, record.settings.task, names=(name, path))


def read_record(path: Path, report: type[SoakRecord] = SoakRecord) -> SoakRecord:
    """Read the record of a finished soak: a file of a history, a report.json of schema `report`, or its folder.

    Raises:
        ConfigError: it cannot be read, was edited, or is of an interrupted soak.
    """
    path = path / "report.json" if os.path.isdir(path) else path
    data = read_json_file(path, CHARACTERS_MAX)
    is_report = isinstance(data, dict) and "monitors" in data
    record = parse(data, report if is_report else SoakRecord, source=str(path))
    _check_record(path, record)
    return record


def _check_record(path: Path, record: SoakRecord) -> None:
    found, expected = record.results_digest, record.sealed()
    if found != expected:
        raise ConfigError(
            f"{path}: results_digest: found {found:.12}, expected {expected:.12}: edited or damaged"
        )
    if record.run.interrupted:
        raise ConfigError(f"{path}: run.interrupted: found true, expected a finished soak")
    counts = record.per_draw_counts
    _check_at_most(path, "running", counts.running, "ticks", counts.ticks)
    _check_at_most(path, "reached", counts.reached, "due", counts.due)


def _check_at_most(path: Path, name: str, part: Sequence[int], of: str, whole: Sequence[int]) -> None:
    for draw, (found, most) in enumerate(zip(part, whole, strict=True)):
        if found > most:
            raise ConfigError(
                f"{path}: per_draw_counts.{name}.{draw}: found {found}, expected at most {most}, its {of}"
            )


def pool(records: Mapping[str, SoakRecord]) -> PerDrawCounts:
    """Return the draws of one or more soaks, by the name used in errors, such as their file.

    Raises:
        ConfigError: two soaks have different identities or monitors, or the same seed and therefore the same draws.
    """
    (first, reference), *_ = records.items()
    name_of_seed: dict[int, str] = {}
    for name, record in records.items():
        check_same_identity(reference.settings.identity, record.settings.identity, names=(first, name))
        monitors = [", ".join(sorted(each.per_draw_counts.hard)) for each in (reference, record)]
        check_same_identity({"hard": monitors[0]}, {"hard": monitors[1]}, names=(first, name))
        seed = record.settings.seed
        if (other := name_of_seed.setdefault(seed, name)) != name:
            raise ConfigError(
                f"{name}: seed: found {seed}, also the seed of {other}: the same draws are no new evidence"
            )
    return concatenate([record.per_draw_counts for record in records.values()])


def check_same_draws(a: SoakRecord, b: SoakRecord, *, names: tuple[str, str]) -> None:
    """Check that `b` differs from `a` in nothing but the policy; `names` are used in errors.

    Raises:
        ConfigError: the first key, by name, whose values differ.
    """
    a_fixed, b_fixed = (
        {**record.settings.identity, **record.settings.draws, "policy_digest": "any"} for record in (a, b)
    )
    check_same_identity(a_fixed, b_fixed, names=names)


def check_same_identity(a: Mapping[str, str], b: Mapping[str, str], *, names: tuple[str, str]) -> None:
    """Check that `a` and `b` have the same keys and values; `names` are used in errors.

    Raises:
        ConfigError: the first key, by name, whose values differ, or that only one of them has.
    """
    for key in sorted(a.keys() | b.keys()):
        if a.get(key) != b.get(key):
            found, expected = b.get(key, "nothing"), a.get(key, "nothing")
            raise ConfigError(f"{names[1]}: {key}: found {found}, but {names[0]} has {expected}")
