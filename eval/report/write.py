"""The files of a report and what lies beside it, all of them or none."""

import fcntl
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from deploy.telemetry.output_files import replacing
from eval.report.html import render
from eval.report.junit import junit
from eval.report.schema.report_data import Report
from robots.errors import OutputError

FILES = {
    "report.json": lambda report: report.model_dump_json(indent=1),
    "report.html": render,
    "junit.xml": junit,
}
LOCK = ".lock"


def claim(out: Path, beside: Collection[str] = ()) -> None:
    """Make the folder `out` and prove, before hours are spent, that the report can be written there.

    Args:
        out: the folder. beside: names of what else will be written.

    Raises:
        OutputError: it cannot.
    """
    probe = out / ".probe"
    with replacing(probe):
        pass
    probe.unlink(missing_ok=True)  # who claims it at the same time deletes the probe of both
    for name in (*FILES, *beside):
        if (out / name).is_dir():
            raise OutputError(f"--out {out}: {name} is a folder, expected a file or nothing of that name")
        if (out / name).parent.is_file():
            place = (out / name).parent.name
            raise OutputError(f"--out {out}: {place} is a file, expected a folder or nothing of that name")


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Hold the folder `out`: two soaks that keep their shards in one would destroy each other's.

    Raises:
        OutputError: another process holds it.
    """
    place = out / LOCK
    with place.open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as e:
            raise OutputError(
                f"--out {out}: another soak is writing there, expected a folder of its own"
            ) from e
        try:
            yield
        finally:
            place.unlink(missing_ok=True)


def write(report: Report, out: Path, beside: Mapping[str, bytes] | None = None) -> None:
    """Write report.json, report.html and junit.xml into the folder `out`, replacing older ones.

    Args:
        report: what they say. out: the folder.
        beside: what else to write there, by name.

    Raises:
        OutputError: the place cannot be written; what stood there stands there still.
    """
    files = {name: text(report).encode() for name, text in FILES.items()} | dict(beside or {})
    with ExitStack() as stack:
        for name, data in files.items():
            stack.enter_context(replacing(out / name)).write_bytes(data)


def erase(out: Path, beside: Collection[str] = ()) -> None:
    """Delete what `write` wrote into the folder `out`, if it did, and folders that are empty then.

    Args:
        out: the folder. beside: names of what else was written.

    Raises:
        OutputError: it cannot be deleted.
    """
    for path in (out / name for name in (*FILES, *beside)):
        try:
            path.unlink(missing_ok=True)
        except OSError as e:
            raise OutputError(f"{path}: cannot be deleted: {e.strerror}") from e
        with suppress(OSError):
            path.parent.rmdir()
