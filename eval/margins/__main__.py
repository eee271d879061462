"""make margins: do the margins of robot.toml keep the true robot inside its limits, whatever a policy says?

See docs/margins.md.
"""

import math
import os
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.telemetry.plain_console import plain_console
from eval.attack.adversaries import OF_MANY
from eval.attack.arena import Setting, find_mode
from eval.attack.pool import Pool, processes
from eval.attack.trained_gains import extreme_gains
from eval.bench.stop_search import GENERATIONS
from eval.margins.derive import ROUNDING, Need, need, noise_of, stop_excess
from eval.margins.excess import SHARES
from eval.margins.robot_file import write_margins
from eval.margins.trial import Trial, run
from robots.errors import ConfigError, printable
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec, load_robot

COLUMNS = (
    *("quantity", "planned up to", "worst excess", "noise", "in a stop", "margin", "present", "needed"),
    "suffices",
)


class Effort(NamedTuple):
    """Number of trials of each adversary, length of the search for stops, and the kind of robots."""

    trials: int
    generations: int
    corners: bool


class Found(NamedTuple):
    """Needed margins of one mode, and the number of robots whose simulation diverged."""

    needs: tuple[Need, ...]
    diverged: int

    @property
    def lacking(self) -> tuple[Need, ...]:
        """Margins that do not suffice."""
        return tuple(each for each in self.needs if not each.holds)


def margins(
    robot: Annotated[str, typer.Option(help="Robot: a name or a folder.")] = "arm6",
    mode: Annotated[
        str, typer.Option(help="What the drives follow: position, velocity or torque.", show_default="all")
    ] = "",
    trials: Annotated[int, typer.Option(help="Trials of 16 robots for 10 s, for each adversary.")] = 24,
    generations: Annotated[int, typer.Option(help="Length of the search for stops.")] = GENERATIONS,
    number: Annotated[int, typer.Option("--workers", help="Number of processes.")] = 2,
    corners: Annotated[bool, typer.Option(help="Robots at the corners of draws.toml.")] = False,
    write: Annotated[bool, typer.Option(help="Write margins that do not suffice into robot.toml.")] = False,
) -> int:
    """Compare the margins of a robot with what its draws.toml needs, in one control mode or in all.

    Exit codes: 0 all suffice, 1 one does not, 2 bad input, 130 interrupted.
    """
    spec = load_robot(robot)
    if spec.base:
        raise ConfigError(
            f"--robot: found {spec.name}, whose drives may saturate: expected one on a fixed base"
        )
    for name, value in (("trials", trials), ("generations", generations), ("workers", number)):
        if value < 1:
            raise ConfigError(f"--{name}: found {value}, expected at least 1")
    if write and not os.access(spec.folder, os.W_OK):
        raise ConfigError(f"--write {spec.folder}: cannot be written")
    modes = (find_mode(mode, spec),) if mode else spec.control_modes
    console, found = plain_console(width=150), dict[ControlMode, Found]()
    with processes(number) as pool:
        for each in modes:
            found[each] = _find(pool, spec, each, Effort(trials, generations, corners), console)
            console.print(_table(spec, each, found[each]))
    if write and any(each.lacking for each in found.values()):
        path = write_margins(spec, {key: each.lacking for key, each in found.items()})
        console.print(f"written: {printable(str(path))}", soft_wrap=True, highlight=False)
    return BUDGET_EXCEEDED if any(each.lacking or each.diverged for each in found.values()) else PASSED


def _find(pool: Pool, spec: RobotSpec, mode: ControlMode, effort: Effort, console: Console) -> Found:
    settings = [
        Setting(robot=spec.folder, mode=mode, gains=gains)
        for gains in (None, *extreme_gains(spec, mode).values())
    ]
    library = OF_MANY * effort.trials
    trials = [
        partial(run, Trial(settings[seed % len(settings)], adversary, seed, effort.corners))
        for seed, adversary in enumerate(library)
    ]
    results = pool.results([partial(stop_excess, spec.in_mode(mode), effort.generations), *trials])
    title = f"{spec.name}, {mode.name.lower()} mode"
    stop, *outcomes = track(results, title, 1 + len(trials), console=console)
    predicted = mode is ControlMode.TORQUE  # in other modes what is sent does not depend on samples
    error = np.max([each.estimate_error for each in outcomes], axis=0)
    noise = noise_of(spec, error) if predicted else {}
    needs = []
    for quantity in outcomes[0].excess:
        worst = np.max([each.excess[quantity].max(axis=0) for each in outcomes], axis=0)
        added = noise.get(quantity, 0.0), stop.get(quantity, 0.0)
        needs.append(need(spec.in_mode(mode), quantity, worst, *added))
    return Found(tuple(needs), sum(each.diverged for each in outcomes))


def _table(spec: RobotSpec, mode: ControlMode, found: Found) -> Table:
    table = Table(*COLUMNS, title=f"{spec.name}, {mode.name.lower()} mode")
    for each in found.needs:
        table.add_row(
            each.quantity,
            f"{each.planned:.1f}" if each.quantity in SHARES else "",
            *(f"{x:.4f}" for x in (each.worst, each.noise, each.stop)),
            each.key,
            f"{each.present:.3f}",
            f"{each.needed:.3f}" if math.isfinite(each.needed) else "",
            _verdict(each),
        )
    if found.diverged:
        table.caption = f"{found.diverged} simulations diverged"
    return table


def _verdict(each: Need) -> str:
    if not each.holds:
        return "no"
    unknown = each.quantity in SHARES and each.present + each.stop > each.planned + ROUNDING
    return "as far as it was planned" if unknown else "yes"


if __name__ == "__main__":
    main(margins)
