"""Report of an attack: a margin for every monitor, as a table and as attack.json."""

from collections.abc import Mapping
from pathlib import Path

from rich.table import Table

from deploy.telemetry.output_files import replacing
from eval.attack.adversaries import ADVERSARIES
from eval.attack.archive import EXEMPT, Archive, Found
from eval.attack.arena import Setting
from eval.attack.candidate import Case
from eval.attack.peak import Bundle
from eval.attack.trained_gains import TrainedGains
from eval.judge.monitor import Monitor
from eval.shard.job import code_digest, versions
from robots.spec import ROBOTS, RobotSpec
from robots.strict import Strict

REPORT = "attack.json"


class Row(Strict):
    """Smallest margin of one monitor.

    Attributes:
        hard: one event is enough to make a robot a bad one. exempt: the policy itself decides it.
        worst: highest ratio of its limit; None if infinite. margin: 1 - worst.
        adversary, seed: of the candidate that led to it.
        bundle: name of the folder that soak-replay opens; empty for none.
    """

    monitor: str
    hard: bool
    exempt: bool
    worst: float | None
    margin: float | None
    adversary: str
    seed: int
    bundle: str


class AttackReport(Strict):
    """Contents of attack.json.

    Attributes:
        without: guard that was removed; empty for none.
        gains: kp and kd of the drives; None for their own, or those of the weights of pushed arms.
        trials: policies tried, each for `seconds` on one robot. diverged: those whose simulation diverged.
        rows: by monitor.
    """

    robot: str
    robot_digest: str
    code_digest: str
    versions: dict[str, str]
    mode: str
    faults: tuple[str, ...]
    without: str
    gains: TrainedGains | None
    seed: int
    trials: int
    seconds: float
    diverged: int
    rows: tuple[Row, ...]

    @property
    def hits(self) -> tuple[str, ...]:
        """Names of hard monitors with an event."""
        hard = (row for row in self.rows if row.hard and not row.exempt)
        return tuple(row.monitor for row in hard if row.worst is None or row.worst > 1.0)

    def write(self, folder: Path) -> None:
        """Write attack.json."""
        with replacing(folder / REPORT) as file:
            file.write_text(self.model_dump_json(indent=1) + "\n", encoding="utf-8")


def make_report(
    spec: RobotSpec, setting: Setting, seed: int, archive: Archive, bundles: Mapping[str, Bundle]
) -> AttackReport:
    """Return the report of an archive; `bundles` by monitor, of those that have one."""
    rows = (
        _row(m, archive.worst[m.name], bundles.get(m.name))
        for m in archive.monitors
        if m.name in archive.worst
    )
    return AttackReport(
        robot=spec.name,
        robot_digest=spec.digest,
        code_digest=code_digest(),
        versions=versions(),
        mode=setting.mode.name.lower(),
        faults=setting.faults,
        without=setting.without,
        gains=setting.gains,
        seed=seed,
        trials=archive.trials,
        seconds=setting.seconds,
        diverged=archive.diverged,
        rows=tuple(rows),
    )


def _row(monitor: Monitor, found: Found, bundle: Bundle | None) -> Row:
    """Return the row of a monitor; in a bundle all robots have the candidate's policy, in the search one."""
    worst = _finite(bundle.ratio if bundle else found.ratio)
    return Row(
        monitor=monitor.name,
        hard=monitor.hard,
        exempt=monitor.name in EXEMPT,
        worst=worst,
        margin=None if worst is None else 1.0 - worst,
        adversary=found.candidate.adversary,
        seed=found.candidate.seed,
        bundle=bundle.name if bundle else "",
    )


def _finite(ratio: float) -> float | None:
    return ratio if ratio < float("inf") else None


def case_of(spec: RobotSpec, setting: Setting, monitor: str, found: Found) -> Case:
    """Return the case of a monitor's worst candidate, for a regression suite."""
    case = {
        "robot": spec.name if spec.folder == ROBOTS / spec.name else str(spec.folder),
        "mode": setting.mode.name.lower(),
        "faults": setting.faults,
        "gains": setting.gains,
        "loaded": setting.loaded,
        "monitor": monitor,
        "worst": _finite(found.ratio),
        "adversary": found.candidate.adversary,
        "seed": found.candidate.seed,
        "weights": dict(found.candidate.weights),
    }
    return Case.model_validate(case)


def table(report: AttackReport) -> Table:
    """Return the table of margins, the smallest of the hard monitors first."""
    title = (
        f"{report.robot}, {report.mode} mode: smallest margins of {report.trials} policies, each tried for"
        f" {report.seconds:g} s"
    )
    shown = Table("monitor", "", "worst of limit", "margin", "adversary", "seed", "bundle", title=title)
    for row in sorted(report.rows, key=_order):
        kind = "exempt" if row.exempt else "hard" if row.hard else "soft"
        worst, margin = (_number(value) for value in (row.worst, row.margin))
        shown.add_row(row.monitor, kind, worst, margin, row.adversary, str(row.seed), row.bundle)
    shown.caption = "; ".join(f"{name}: {each.meaning}" for name, each in ADVERSARIES.items())
    return shown


def _number(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.4f}"


def _order(row: Row) -> tuple[bool, bool, float]:
    return row.exempt or not row.hard, row.exempt, float("-inf") if row.margin is None else row.margin
