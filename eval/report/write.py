"""The three files of a report, all of them or none."""

from contextlib import ExitStack
from pathlib import Path

from deploy.output import replacing
from eval.report.data import Report
from eval.report.html import render
from eval.report.junit import junit
from robots.errors import OutputError

FILES = {
    "report.json": lambda report: report.model_dump_json(indent=1),
    "report.html": render,
    "junit.xml": junit,
}


def claim(out: Path) -> None:
    """Make the folder `out` and prove, before hours are spent, that the report can be written there.

    Raises:
        OutputError: it cannot.
    """
    probe = out / ".probe"
    with replacing(probe):
        pass
    probe.unlink()
    for name in FILES:
        if (out / name).is_dir():
            raise OutputError(f"--out {out}: {name} is a folder, expected a file or nothing of that name")


def write(report: Report, out: Path) -> None:
    """Write report.json, report.html and junit.xml into the folder `out`, replacing older ones.

    Raises:
        OutputError: the place cannot be written; what stood there stands there still.
    """
    texts = {name: text(report) for name, text in FILES.items()}
    with ExitStack() as stack:
        for name, text in texts.items():
            stack.enter_context(replacing(out / name)).write_text(text, encoding="utf-8")
