"""make mutants: remove each guard of `deploy` in turn, and check that the judge reports it.

Both runs of a row have the same robots in the same situation. A guard that would act earlier is
removed in both runs.
"""

import time
from typing import Annotated

import mujoco
import typer
from rich.table import Table

from deploy.command_line import BUDGET_EXCEEDED, PASSED, main
from deploy.telemetry.plain_console import plain_console
from eval.mutants.situation import ROBOTS
from eval.mutants.suite import MUTANTS, Row, idle_budget_failures, run_mutants, silent_monitors
from robots.errors import ConfigError
from robots.spec import RobotSpec, load_robot

console = plain_console(width=160)


def mutants(
    robot: Annotated[str, typer.Option(help="Robot: a name or a folder.")] = "arm6",
    only: Annotated[str, typer.Option(help="Only guards whose description contains this text.")] = "",
) -> int:
    """Remove each guard in turn and print the events of the judge."""
    spec, chosen = load_robot(robot), tuple(m for m in MUTANTS if only in m.guard)
    if not chosen:
        raise ConfigError(
            f"mutants: --only {only!r}: no such guard, expected a part of: {'; '.join(m.guard for m in MUTANTS)}"
        )
    mujoco.set_mju_user_warning(lambda text: None)  # simulations diverge here on purpose; the judge counts it
    began, found = time.monotonic(), []
    for row in run_mutants(spec, chosen):
        found.append(row)
        console.print(f"{'caught' if row.caught else 'MISSED'}  {row.mutant.guard}", highlight=False)
    console.print(_table(found))
    good = all(row.caught for row in found)
    if not only:
        good = _at_once(spec) and good
    console.print(
        f"{sum(row.caught for row in found)} of {len(found)} caught in {time.monotonic() - began:.0f} s"
    )
    return PASSED if good else BUDGET_EXCEEDED


def _at_once(spec: RobotSpec) -> bool:
    quiet, broken = silent_monitors(spec), idle_budget_failures(spec)
    console.print(f"all guards off, draws doubled: monitors without events: {', '.join(quiet) or 'none'}")
    console.print(f"idle policy: budget lines exceeded: {', '.join(broken) or 'none'}")
    return not quiet and "goal_success" in broken


def _table(found: list[Row]) -> Table:
    table = Table(
        *("guard and its removal", "situation", "monitor", "with", "without", ""),
        title=f"{ROBOTS} robots, the same for both: events of the monitor with the guard and without it",
    )
    for row in found:
        mutant = row.mutant
        shown = ["no such monitor" if n is None else str(n) for n in (row.with_guard, row.without_guard)]
        verdict = "caught" if row.caught else "MISSED"
        table.add_row(mutant.guard, mutant.situation.description, mutant.monitor, *shown, verdict)
    return table


if __name__ == "__main__":
    main(mutants)
