"""make margins: do the margins of robot.toml keep the true robot inside its limits, whatever a policy says?

See docs/margins.md.
"""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from eval.attack.adversaries import ADVERSARIES
from eval.attack.arena import Setting, find_mode
from eval.attack.pool import begin_worker
from eval.bench.stop_search import GENERATIONS
from eval.margins.derive import Need, need, noise_of, stop_excess
from eval.margins.excess import SHARES
from eval.margins.robot_file import write_margins
from eval.margins.trial import Trials, Tried, run
from robots.child_process import Lifeline
from robots.errors import ConfigError
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec, load_robot

TASKS = 8
"""Shards that a process builds before another takes its place: what they leave behind is freed late."""
COLUMNS = ("quantity", "at", "worst excess", "noise", "in a stop", "margin", "present", "needed", "")


class Effort(NamedTuple):
    """Number of shards and trials of each adversary, length of the search for stops, and the kind of robots."""

    seeds: int
    trials: int
    generations: int
    corners: bool


def margins(
    robot: Annotated[str, typer.Option(help="Robot: a name or a folder.")] = "arm6",
    mode: Annotated[
        str, typer.Option(help="What the drives follow: position, velocity or torque.", show_default="all")
    ] = "",
    seeds: Annotated[int, typer.Option(help="Number of shards of 16 robots for each adversary.")] = 4,
    trials: Annotated[int, typer.Option(help="Trials of 10 s of each robot and adversary.")] = 6,
    generations: Annotated[int, typer.Option(help="Length of the search for stops.")] = GENERATIONS,
    processes: Annotated[int, typer.Option("--workers", help="Number of processes.")] = 2,
    corners: Annotated[bool, typer.Option(help="Robots at the corners of draws.toml.")] = False,
    write: Annotated[bool, typer.Option(help="Write margins that do not suffice into robot.toml.")] = False,
) -> int:
    """Compare the margins of a robot with what its draws.toml needs, in one control mode or in all.

    Exit codes: 0 all suffice, 1 one does not, 2 bad input.
    """
    spec = load_robot(robot)
    if spec.base:
        raise ConfigError(
            f"--robot: found {spec.name}, whose drives may saturate: expected one on a fixed base"
        )
    for name, value in (
        ("seeds", seeds),
        ("trials", trials),
        ("generations", generations),
        ("workers", processes),
    ):
        if value < 1:
            raise ConfigError(f"--{name}: found {value}, expected at least 1")
    modes = (find_mode(mode, spec),) if mode else spec.control_modes
    console, found = Console(width=140), dict[ControlMode, list[Need]]()
    with (
        Lifeline() as lifeline,
        ProcessPoolExecutor(
            processes, get_context("spawn"), begin_worker, (lifeline.end,), max_tasks_per_child=TASKS
        ) as pool,
    ):
        for each in modes:
            found[each] = list(_needs(pool, spec, each, Effort(seeds, trials, generations, corners), console))
            console.print(_table(spec, each, found[each]))
    lacking = {mode: [each for each in needs if not each.holds] for mode, needs in found.items()}
    if write and any(lacking.values()):
        console.print(f"written: {write_margins(spec, lacking)}", soft_wrap=True, highlight=False)
    return BUDGET_EXCEEDED if any(lacking.values()) else PASSED


def _needs(
    pool: ProcessPoolExecutor,
    spec: RobotSpec,
    mode: ControlMode,
    effort: Effort,
    console: Console,
) -> Iterator[Need]:
    setting, name = Setting(robot=spec.folder, mode=mode), mode.name.lower()
    stop = pool.submit(stop_excess, spec.in_mode(mode), effort.generations)
    jobs = [
        Trials(setting, adversary, seed, effort.trials, effort.corners)
        for seed in range(effort.seeds)
        for adversary in ADVERSARIES
    ]
    tried: list[Tried] = list(track(pool.map(run, jobs), f"{name}: trials", len(jobs), console=console))
    predicted = mode is ControlMode.TORQUE  # in other modes what is sent does not depend on samples
    error = np.max([each.estimate_error for each in tried], axis=0)
    noise = noise_of(spec, error) if predicted else {}
    for quantity in tried[0].excess:
        worst = np.max([each.excess[quantity].max(axis=0) for each in tried], axis=0)
        added = noise.get(quantity, 0.0), stop.result().get(quantity, 0.0)
        yield need(spec.in_mode(mode), quantity, worst, *added)


def _table(spec: RobotSpec, mode: ControlMode, needs: list[Need]) -> Table:
    table = Table(*COLUMNS, title=f"{spec.name}, {mode.name.lower()} mode")
    for each in needs:
        numbers = (each.worst, each.noise, each.stop)
        table.add_row(
            each.quantity,
            f"{each.planned:.1f}" if each.planned else "",
            *(f"{x:.4f}" for x in numbers),
            each.key,
            f"{each.present:.3f}",
            "any" if each.needed == 1.0 and each.quantity in SHARES else f"{each.needed:.3f}",
            "" if each.holds else "does not suffice",
        )
    return table


if __name__ == "__main__":
    main(margins)
