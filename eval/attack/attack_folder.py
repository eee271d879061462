"""Folder of an attack: report, cases, and bundles of the worst that was found."""

import os
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from deploy.telemetry.output_files import check_no_links
from eval.attack.arena import Setting
from eval.attack.candidate import Case
from eval.attack.report import REPORT, AttackReport
from eval.judge.monitors import NAMES
from eval.replay.bundle_files import copy_bundles, delete_bundles
from eval.report.report_files import check_report_folder
from robots.errors import ConfigError, output_error
from robots.spec import RobotSpec

WORST, CASES, UNFINISHED = "worst", "cases", "unfinished"
"""Folders of bundles, of cases, and of an attack that has not finished, with both."""
FOLDERS = (WORST, CASES, UNFINISHED, f"{UNFINISHED}/{WORST}", f"{UNFINISHED}/{CASES}")


class AttackFolder:
    """Folder of an attack; all that is written goes into unfinished/ first.

    Attributes:
        path: of the folder. unfinished: where workers write bundles.
        case_files: of each monitor, relative to `path`.
    """

    def __init__(self, path: Path, spec: RobotSpec, setting: Setting) -> None:
        self.path, self.unfinished = path, path / UNFINISHED
        options = f"{'-faults' if setting.faults else ''}{'-gains' if setting.gains else ''}"
        start = f"{spec.name}-{setting.mode.name.lower()}{options}"
        self.case_files = {name: f"{CASES}/{start}-{name}.json" for name in NAMES}

    def check(self) -> None:
        """Refuse a folder in which something is in the way, or whose cases are of no earlier attack.

        Raises:
            ConfigError, OutputError: before there is any work to lose.
        """
        self.check_links()
        check_report_folder(self.path, (REPORT, *self.case_files.values()))
        if os.path.exists(self.path / CASES) and not os.path.exists(self.path / REPORT):
            raise ConfigError(
                f"--out {self.path}: found {CASES}/ without {REPORT}, expected a folder of an attack, or a new one"
            )

    def check_links(self) -> None:
        """Refuse (OutputError) links in the place of folders."""
        check_no_links(self.path, FOLDERS)

    def keep_bundles(self, names: Collection[str]) -> None:
        """Keep bundles of some names, and delete the others that workers wrote."""
        copy_bundles(self.unfinished, self.unfinished / WORST, names)
        delete_bundles(self.unfinished, finished=True)

    def write(self, report: AttackReport, cases: Mapping[str, Case], *, finished: bool) -> Path:
        """Write a report and the cases of monitors; return the path of the report.

        Those of a finished attack, and its bundles, replace those of an earlier one.
        """
        _write(report, {self.case_files[name]: case for name, case in cases.items()}, self.unfinished)
        if not finished:
            return self.unfinished / REPORT
        _write(report, {self.case_files[name]: case for name, case in cases.items()}, self.path)
        _delete(self.path / file for name, file in self.case_files.items() if name not in cases)
        copy_bundles(self.unfinished / WORST, self.path / WORST)
        self.clear()
        return self.path / REPORT

    def clear(self) -> None:
        """Delete what an attack that has not finished has left."""
        _delete(self.unfinished / file for file in (REPORT, *self.case_files.values()))
        for folder in (self.unfinished, self.unfinished / WORST):
            delete_bundles(folder, finished=True)
        for folder in (self.unfinished / WORST, self.unfinished / CASES, self.unfinished):
            with suppress(OSError):
                folder.rmdir()


def _write(report: AttackReport, cases: Mapping[str, Case], folder: Path) -> None:
    report.write(folder)
    for file, case in cases.items():
        case.write(folder / file)


def _delete(paths: Iterable[Path]) -> None:
    for path in paths:
        try:
            path.unlink(missing_ok=True)
        except OSError as e:  # it or its folder has changed since the search began
            raise output_error(f"--out {path}: cannot be deleted: {e.strerror}", e) from e
