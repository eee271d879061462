"""Files of a report, junit.xml included: check the folder, write all files or none, delete them."""

import os
from collections.abc import Collection, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path

from junitparser import Failure, JUnitXml, Skipped, TestCase, TestSuite

from deploy.operation.interrupts import held_back
from deploy.telemetry.output_files import check_folder, replacing
from eval.report.html import render
from eval.report.schema.report_data import Report
from eval.statistics.budget import BudgetLine
from robots.errors import OutputError


def junit(report: Report) -> str:
    """Return the XML text; lines of an interrupted soak that have passed so far are marked as skipped."""
    suite = TestSuite("soak-test")
    suite.timestamp, suite.time = report.run.started, report.run.wall_s
    suite.add_property("statement", report.statement)
    suite.add_property("policy_digest", report.settings.policy_digest)
    for line in report.budget:
        case = TestCase(line.name, classname=f"soak.{report.settings.robot}", time=0)
        if not line.passed:
            case.result = [Failure(describe(line), "budget")]
        elif report.run.interrupted:
            case.result = [Skipped(f"interrupted after {report.run.hours:.3g} h; so far {describe(line)}")]
        suite.add_testcase(case)
    document = JUnitXml()
    document.add_testsuite(suite)
    return document.tostring().decode()


def describe(line: BudgetLine) -> str:
    """Return what was found and what is allowed, in words."""
    found = "not finite" if line.found is None else f"{line.found:.6g}"
    bound = "at least" if line.at_least else "at most"
    allowed = "no limit" if line.allowed is None else f"allowed {bound} {line.allowed:.6g}"
    about = f" ({line.about})" if line.about else ""
    return f"{line.name}: found {found} {line.unit}, {allowed}{about}"


PAGE = "report.html"
FILES = {"report.json": lambda report: report.model_dump_json(indent=1), PAGE: render, "junit.xml": junit}


def check_report_folder(out: Path, extra: Collection[str] = ()) -> None:
    """Make the folder `out`, and check before hours are spent that the report and `extra` files can be written there.

    Raises:
        OutputError: it cannot be written.
    """
    check_folder(out)
    paths = [out / name for name in (*FILES, *extra)]
    for path in filter(os.path.isdir, paths):
        raise OutputError(f"--out {path}: found a folder, expected a file or nothing")
    for folder in filter(os.path.exists, {path.parent for path in paths} - {out}):
        check_folder(folder)


def write_report(report: Report, out: Path, extra: Mapping[str, bytes] | None = None) -> None:
    """Write report.json, report.html, junit.xml and `extra` files into the folder `out`, replacing older ones.

    Raises:
        OutputError: the folder cannot be written; the older files remain.
    """
    files = {name: text(report).encode() for name, text in FILES.items()} | dict(extra or {})
    with ExitStack() as stack:
        for name, data in files.items():
            stack.enter_context(replacing(out / name)).write_bytes(data)
        with held_back():  # a signal between two of them would leave new files beside old ones
            stack.close()


def delete_report(out: Path, extra: Collection[str] = ()) -> None:
    """Delete the files of `write_report` in the folder `out`, if there are any, and folders that are empty then.

    Nothing behind a link is deleted.

    Raises:
        OutputError: they cannot be deleted.
    """
    paths = [out / name for name in (*FILES, *extra)]
    for path in (each for each in paths if not os.path.islink(out) and not os.path.islink(each.parent)):
        try:
            path.unlink(missing_ok=True)
        except OSError as e:
            raise OutputError(f"{path}: cannot be deleted: {e.strerror}") from e
        with suppress(OSError):
            path.parent.rmdir()
