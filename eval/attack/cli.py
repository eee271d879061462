"""soak-attack: search for the policy that brings each monitor closest to its limit."""

import signal
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.operation.interrupts import handled, interrupt
from deploy.telemetry.folder_lock import locked
from deploy.telemetry.plain_console import plain_console
from eval.attack.adversaries import pushed_arms
from eval.attack.archive import Archive, Found
from eval.attack.arena import Setting, find_mode
from eval.attack.attack_folder import CASES, WORST, AttackFolder
from eval.attack.fault_classes import find_faults
from eval.attack.guards import guarded_monitor
from eval.attack.peak import Bundle
from eval.attack.pool import Workers, workers
from eval.attack.report import REPORT, AttackReport, case_of, make_report, table
from eval.attack.search import Search
from eval.attack.trained_gains import find_gains
from robots.errors import ConfigError, printable
from robots.randomness import SEED_MAX
from robots.spec import RobotSpec, load_robot

MINUTES_MAX = 1e6
INTERRUPTED = "interrupted: the report covers what was tried so far"
COLUMNS = (
    TextColumn("attacking: {task.description}"),
    BarColumn(),
    TimeElapsedColumn(),
    TextColumn("left"),
    TimeRemainingColumn(),
)

Robot = Annotated[str, typer.Option(help="Robot: a name or a folder.")]
Mode = Annotated[str, typer.Option(help="What the drives follow: position, velocity or torque.")]
Seed = Annotated[int, typer.Option(help="Seed of the search and of all draws.")]
Processes = Annotated[
    int, typer.Option("--workers", help="Number of processes; results do not depend on it.")
]
Minutes = Annotated[float, typer.Option(help="Time of the search, min; it ends after a whole generation.")]
Generations = Annotated[
    int | None,
    typer.Option(
        help="Length of the search in place of --minutes: the same on any computer.", show_default="none"
    ),
]
Faults = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        help="Fault class; one of those given is injected into each robot. Can be repeated; all: every class.",
        show_default="none",
    ),
]
Without = Annotated[
    str,
    typer.Option(
        help="Part of the name of a guard (make mutants lists them) to remove: a test of the attack."
    ),
]
GainsOf = Annotated[
    str,
    typer.Option(
        "--gains",
        help="Policy (ONNX) whose drive gains the adversaries have, as that of a robot that walks; or softest or"
        " stiffest: the bounds of what a contract may have.",
        show_default="the drives' own; on pushed arms they are searched",
    ),
]
Out = Annotated[Path, typer.Option(help=f"Folder for {REPORT}, bundles ({WORST}/) and cases ({CASES}/).")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """Length of a search: s, or generations if they are given."""

    seconds: float
    generations: int | None

    def progress(self, generations: int, seconds: float) -> float:
        """Return the share that is used up."""
        used = seconds / self.seconds if self.generations is None else generations / self.generations
        return min(used, 1.0)


def soak_attack(
    robot: Robot = "arm6",
    mode: Mode = "position",
    seed: Seed = 7,
    processes: Processes = 2,
    minutes: Minutes = 10.0,
    generations: Generations = None,
    faults: Faults = None,
    without: Without = "",
    gains_of: GainsOf = "",
    out: Out = Path("out/attack"),
) -> int:
    """Search over policies and draws for the smallest margin of every monitor; its results enter no rate.

    The report of an earlier attack in --out is replaced only when this one has finished; that of an interrupted one is
    in unfinished/ until the next writes its own.

    Exit codes: 0 every hard monitor kept its limit, 1 one did not, 2 bad input, 130 interrupted.
    """
    _check_options(seed, processes, minutes, generations)
    spec = load_robot(robot)
    drives = find_mode(mode, spec)
    classes = find_faults(faults or (), spec, drives, "--fault")
    gains = find_gains(gains_of, spec, drives) if gains_of else None
    setting = Setting(robot=spec.folder, mode=drives, faults=classes, without=without, gains=gains)
    target = guarded_monitor(without, setting.mode, Archive(spec, setting.mode).hard) if without else ""
    folder = AttackFolder(out, spec, setting)
    folder.check()
    with ExitStack() as printing, locked(out), workers(setting, processes) as pool:
        search, console = _search(spec, setting, pool, seed, target), plain_console()
        with handled(signal.SIG_IGN):  # `_run` and `_write_bundles` handle them
            finished = _run(search, Budget(seconds=60.0 * minutes, generations=generations), console)
            if not search.archive.trials:
                raise KeyboardInterrupt  # an earlier attack, even one that has not finished, has more to say
            found = {} if setting.without else _worst(search.archive)
            cases = {name: case_of(spec, setting, name, each) for name, each in found.items()}
            folder.clear()
            bundles, complete = dict[str, Bundle](), False
            try:
                _write_bundles(found, pool, folder, bundles, console, [] if finished else [INTERRUPTED])
                complete = finished and len(bundles) == len(found)
            finally:
                report = make_report(spec, setting, seed, search.archive, bundles)
                path = folder.write(report, cases, finished=complete)
            printing.callback(_print, report, path, bundles_missing=len(bundles) < len(found))
        if not complete:
            raise KeyboardInterrupt  # workers need not finish what they do
    return BUDGET_EXCEEDED if report.hits or report.diverged else PASSED


def _search(spec: RobotSpec, setting: Setting, pool: Workers, seed: int, target: str) -> Search:
    """Return the search; pushed arms have a fixed base, and no fault beside their push."""
    arms = () if spec.base or setting.faults else pushed_arms(setting.mode, gains=setting.gains is not None)
    return Search(spec, setting.mode, pool.evaluate, seed=seed, target=target, pushed_arms=arms)


def _run(search: Search, budget: Budget, console: Console) -> bool:
    """Search until the budget is used up, or a target of one monitor is hit; return False if it was interrupted."""
    began, number = time.monotonic(), 0
    with suppress(KeyboardInterrupt), handled(interrupt), Progress(*COLUMNS, console=console) as bar:
        shown = bar.add_task("the library", total=1.0)
        for number, _ in enumerate(search.run(), start=1):
            used = budget.progress(number, time.monotonic() - began)
            bar.update(shown, completed=used, description=_state(search.archive))
            if used >= 1.0 or (len(search.targets) == 1 and search.targets[0] in search.archive.hits):
                return True
    return False


def _state(archive: Archive) -> str:
    """Return the hard monitor nearest to its limit, in words."""
    ratio, name = max((archive.worst[name].ratio, name) for name in archive.hard)
    return f"{archive.trials} trials, worst {name} {ratio:.4f}"


def _worst(archive: Archive) -> dict[str, Found]:
    """Return the worst candidate of each hard monitor; those with a ratio of 0 are left out."""
    worst = archive.worst
    return {name: worst[name] for name in archive.hard if name in worst and worst[name].ratio > 0.0}


def _write_bundles(
    found: dict[str, Found],
    pool: Workers,
    folder: AttackFolder,
    bundles: dict[str, Bundle],
    console: Console,
    notes: Sequence[str],
) -> None:
    """Print notes; write bundles, which takes minutes, and add them to `bundles` by monitor, fewer if interrupted."""
    with suppress(KeyboardInterrupt), handled(interrupt):
        console.print("\n".join((*notes, f"writing {len(found)} bundles")))
        try:
            bundles.update(pool.write_bundles(found, folder.unfinished))
        finally:
            folder.keep_bundles({bundle.name for bundle in bundles.values()})


def _print(report: AttackReport, path: Path, *, bundles_missing: bool) -> None:
    """Print the table and the verdict, once signals end the process again, which may wait for a reader."""
    console = plain_console(width=160)
    if bundles_missing:
        console.print("interrupted: the report covers the bundles written so far")
    console.print(table(report))
    console.print(f"{_verdict(report)}\nreport: {printable(str(path))}", soft_wrap=True, highlight=False)


def _verdict(report: AttackReport) -> str:
    diverged = f"; {report.diverged} simulations diverged" if report.diverged else ""
    return (f"hard events: {', '.join(report.hits)}" if report.hits else "no hard event") + diverged


def _check_options(seed: int, processes: int, minutes: float, generations: int | None) -> None:
    bounds = (
        ("--seed", seed, 0 <= seed <= SEED_MAX, f"from 0 to {SEED_MAX}"),
        ("--workers", processes, 1 <= processes <= 1024, "from 1 to 1024"),
        ("--minutes", minutes, 0.0 < minutes <= MINUTES_MAX, f"above 0, at most {MINUTES_MAX:g}"),
        ("--generations", generations, generations is None or generations >= 1, "at least 1"),
    )
    for name, value, valid, expected in bounds:
        if not valid:
            raise ConfigError(f"{name}: found {value}, expected {expected}")


def cli() -> None:
    """Entry point of `soak-attack`."""
    main(soak_attack)
