"""A folder of nights: each is a file of its own, written whole or not at all, and never written again."""

from collections.abc import Iterator
from datetime import UTC
from pathlib import Path

from deploy.telemetry.output_files import replacing
from eval.history.night_record import Night, Settings
from eval.report.schema.report_data import Report
from eval.statistics.pooling import same_identity
from robots.errors import ConfigError
from robots.strict import parse, read_json

SUFFIX = ".night.json"
CHARACTERS_MAX = 1 << 28
"""Of a night, and of a report."""


def claim_history(folder: Path) -> None:
    """Make `folder` and prove, before hours are spent, that a night can be kept there.

    Raises:
        OutputError: it cannot.
    """
    probe = folder / ".probe"
    with replacing(probe, option="--history"):
        pass
    probe.unlink(missing_ok=True)  # who claims it at the same time deletes the probe of both


def keep(night: Night, folder: Path) -> Path:
    """Write the night that `night` is, without the rest of a report, under a name of its own.

    Raises:
        OutputError: it cannot be written.
    """
    path = next(place for place in _names(night, folder) if not place.exists())
    with replacing(path, option="--history") as file:
        file.write_text(night.model_dump_json(include={*Night.model_fields}, indent=1), encoding="utf-8")
    return path


def _names(night: Night, folder: Path) -> Iterator[Path]:
    """By start and seed; in the case of two in the same second, by number."""
    name, number = f"{night.run.moment.astimezone(UTC):%Y%m%dT%H%M%SZ}-seed{night.settings.seed}", 1
    yield folder / f"{name}{SUFFIX}"
    while True:
        number += 1
        yield folder / f"{name}-{number}{SUFFIX}"


def read_history(folder: Path) -> dict[str, Night]:
    """The nights in `folder` by file, in the order of time.

    Raises:
        ConfigError: one cannot be read, was edited, or was asked for another task than the first.
    """
    files = sorted(path for path in folder.glob(f"*{SUFFIX}") if not path.name.startswith("."))
    nights = {str(path): read_night(path) for path in files}
    in_time = dict(sorted(nights.items(), key=lambda each: each[1].run.moment))
    if in_time:
        name, first = next(iter(in_time.items()))
        same_task(in_time, first.settings, name)
    return in_time


def same_task(nights: dict[str, Night], settings: Settings, name: str) -> None:
    """Refuse nights that were asked for another task than `settings`, which are those of `name`.

    Raises:
        ConfigError: naming the file and the first field that differs.
    """
    for path, night in nights.items():
        same_identity(settings.task, night.settings.task, names=(name, path))


def read_night(path: Path) -> Night:
    """A night from its file, from a report.json, or from the folder of one.

    Raises:
        ConfigError: it cannot be read, was edited, or did not end.
    """
    path = path / "report.json" if path.is_dir() else path
    data = read_json(_text(path), str(path), CHARACTERS_MAX)
    of_report = isinstance(data, dict) and "monitors" in data
    night = parse(data, Report if of_report else Night, source=str(path))
    found, expected = night.results_digest, night.sealed()
    if found != expected:
        raise ConfigError(
            f"{path}: results_digest: found {found:.12}, expected {expected:.12}: edited or damaged"
        )
    if night.run.interrupted:
        raise ConfigError(f"{path}: run.interrupted: found true, expected a soak that ran to its end")
    return night


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as e:
        raise ConfigError(f"{path}: cannot be read: {e.strerror}") from e
    except UnicodeDecodeError as e:
        raise ConfigError(f"{path}: not valid JSON: {e}") from e
