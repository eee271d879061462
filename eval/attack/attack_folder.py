"""Folder of an attack: report, cases, and bundles of the worst that was found."""

import os
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from deploy.telemetry.output_files import check_folder, check_no_links
from eval.attack.arena import Setting
from eval.attack.candidate import Case
from eval.attack.report import REPORT, AttackReport
from eval.judge.monitors import NAMES
from eval.replay.bundle_files import copy_bundles, delete_bundles
from eval.report.report_files import check_report_folder
from robots.errors import ConfigError, OutputError, ResultLostError, output_error
from robots.spec import RobotSpec

WORST, CASES, UNFINISHED = "worst", "cases", "unfinished"
"""Folders of bundles, of cases, and of an attack that has not finished."""
UNFINISHED_FOLDERS = (UNFINISHED, f"{UNFINISHED}/{WORST}", f"{UNFINISHED}/{CASES}")
FOLDERS = (WORST, CASES, *UNFINISHED_FOLDERS)


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
        check_no_links(self.path, FOLDERS)
        for folder in (self.path / name for name in FOLDERS):
            if os.path.exists(folder):
                check_folder(folder)
        check_report_folder(self.path, (REPORT, *self.case_files.values()))
        if os.path.exists(self.path / CASES) and not os.path.exists(self.path / REPORT):
            raise ConfigError(
                f"--out {self.path}: found {CASES}/ without {REPORT}, expected a folder of an attack, or a new one"
            )

    def clear(self) -> None:
        """Delete what an earlier attack left in unfinished/, before workers write bundles there.

        Raises:
            OutputError: a link was made there since `check`.
        """
        check_no_links(self.path, UNFINISHED_FOLDERS)
        _delete([self.unfinished / REPORT, *(self.unfinished / CASES).glob("*.json")])
        for folder in (self.unfinished, self.unfinished / WORST):
            delete_bundles(folder, finished=True)
        for folder in (self.unfinished / WORST, self.unfinished / CASES, self.unfinished):
            with suppress(OSError):
                folder.rmdir()

    def keep_bundles(self, names: Collection[str]) -> None:
        """Keep bundles of some names in unfinished/, and delete the others that workers wrote."""
        copy_bundles(self.unfinished, self.unfinished / WORST, names)
        delete_bundles(self.unfinished, finished=True)

    def write(self, report: AttackReport, cases: Mapping[str, Case], *, finished: bool) -> Path:
        """Write a report and the cases of monitors; return the path of the report.

        Those of a finished attack, and its bundles, replace those of an earlier one.

        Raises:
            OutputError: unfinished/ cannot be written.
            ResultLostError: something is in the way of a finished attack, which stays in unfinished/.
        """
        files = {self.case_files[name]: case for name, case in cases.items()}
        check_no_links(self.path, UNFINISHED_FOLDERS)
        _write(report, files, self.unfinished)
        if not finished:
            return self.unfinished / REPORT
        try:
            self._publish(report, files)
        except OutputError as e:
            raise ResultLostError(f"not kept: {e}\nthe report is in {self.unfinished}") from e
        return self.path / REPORT

    def _publish(self, report: AttackReport, files: Mapping[str, Case]) -> None:
        """Replace bundles, cases and report of an earlier attack."""
        check_no_links(self.path, FOLDERS)  # made since `check`
        copy_bundles(self.unfinished / WORST, self.path / WORST)
        _delete(self.path / file for file in self.case_files.values() if file not in files)
        _write(report, files, self.path)
        self.clear()


def _write(report: AttackReport, files: Mapping[str, Case], folder: Path) -> None:
    """Write cases by their files, and the report, which names them, last."""
    for file, case in files.items():
        case.write(folder / file)
    report.write(folder)


def _delete(paths: Iterable[Path]) -> None:
    for path in paths:
        try:
            path.unlink(missing_ok=True)
        except OSError as e:  # it or its folder has changed since `check`
            raise output_error(f"--out {path}: cannot be deleted: {e.strerror}", e) from e
