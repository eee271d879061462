"""History: a folder with one file for each finished soak, written whole or not at all and never overwritten."""

from collections.abc import Iterator
from datetime import UTC
from pathlib import Path

from deploy.telemetry.output_files import replacing
from eval.history.pooling import same_identity
from eval.history.soak_record import Settings, SoakRecord
from robots.errors import ConfigError
from robots.strict import parse, read_json

SUFFIX = ".soak.json"
CHARACTERS_MAX = 1 << 28
"""Upper bound of the size of a record or report."""


def claim_history(folder: Path) -> None:
    """Make `folder` and check, before hours are spent, that a record can be written there.

    Raises:
        OutputError: it cannot.
    """
    probe = folder / ".probe"
    with replacing(probe, option="--history"):
        pass
    probe.unlink(missing_ok=True)  # another soak that claims the folder at the same time deletes it too


def add_record(record: SoakRecord, folder: Path) -> Path:
    """Write the fields of `SoakRecord`, without the rest of a report, to a new file and return its path.

    Raises:
        OutputError: it cannot be written.
    """
    path = next(place for place in _names(record, folder) if not place.exists())
    with replacing(path, option="--history") as file:
        file.write_text(
            record.model_dump_json(include={*SoakRecord.model_fields}, indent=1), encoding="utf-8"
        )
    return path


def _names(record: SoakRecord, folder: Path) -> Iterator[Path]:
    """Candidate paths: start time and seed, then with a number for soaks that began in the same second."""
    name = f"{record.run.moment.astimezone(UTC):%Y%m%dT%H%M%SZ}-seed{record.settings.seed}"
    number = 1
    yield folder / f"{name}{SUFFIX}"
    while True:
        number += 1
        yield folder / f"{name}-{number}{SUFFIX}"


def read_history(folder: Path) -> dict[str, SoakRecord]:
    """Return the records in `folder` by file name, in the order of their start.

    Raises:
        ConfigError: a file cannot be read, was edited, or has another task than the first.
    """
    files = sorted(path for path in folder.glob(f"*{SUFFIX}") if not path.name.startswith("."))
    records = {str(path): read_record(path) for path in files}
    by_time = dict(sorted(records.items(), key=lambda item: item[1].run.moment))
    if by_time:
        name, first = next(iter(by_time.items()))
        same_task(by_time, first.settings, name)
    return by_time


def same_task(records: dict[str, SoakRecord], settings: Settings, name: str) -> None:
    """Check that the task of every record is that of `settings`, which belong to `name`.

    Raises:
        ConfigError: naming the file and the first field that differs.
    """
    for path, record in records.items():
        same_identity(settings.task, record.settings.task, names=(name, path))


def read_record(path: Path, report: type[SoakRecord] = SoakRecord) -> SoakRecord:
    """Read the record of a finished soak.

    Args:
        path: a file of a history, a report.json, or the folder of one.
        report: schema of a report.json, which has more fields.

    Raises:
        ConfigError: it cannot be read, was edited, or is of an interrupted soak.
    """
    path = path / "report.json" if path.is_dir() else path
    data = read_json(_text(path), str(path), CHARACTERS_MAX)
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


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as e:
        raise ConfigError(f"{path}: cannot be read: {e.strerror}") from e
    except UnicodeDecodeError as e:
        raise ConfigError(f"{path}: not valid JSON: {e}") from e
