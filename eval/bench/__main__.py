"""Table of benches, each of which measures some of the figures in the README.

python -m eval.bench stages            cost of a tick without physics, at several B, stage by stage
python -m eval.bench throughput        soak time ÷ bare physics time; a second worker; wider shards
python -m eval.bench reproducibility   equal results for any number of workers, and after an interruption
python -m eval.bench kills             the same after `kill -9` at 30 random moments; nothing left running
python -m eval.bench estimate          errors with and without the estimator, consistency, an outage
python -m eval.bench floating          errors of a floating base with and without its feet, consistency, cost
python -m eval.bench ablation          the same trial with one stage of the stack replaced
python -m eval.bench heat              the hottest motors in the hottest rooms, with the heat guard and without
python -m eval.bench startup           time to the first tick of deploy-run, and its imports
python -m eval.bench memory            growth of a soak's memory
python -m eval.bench budget            half an hour of 32 robots by the shipped budget; an idle policy that fails it
python -m eval.bench teleport          a policy that asks for far angles: drives without limits, real ones, a cap
python -m eval.bench adversaries       policies that ask for anything, in velocity and torque mode: an hour, 16 robots
python -m eval.bench faults            every fault class under the library of adversaries: half an hour
python -m eval.bench stops             the worst stop that safety accepts: torque, tool, gap between shapes
python -m eval.bench walk              a walking robot beside a bare loop: --robot FOLDER --policy FILE
python -m eval.bench                   all of them but kills, adversaries, faults and walk
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from deploy.command_line import PASSED, main
from deploy.telemetry.plain_console import plain_console
from eval.bench.ablation.ablation import ablation
from eval.bench.ablation.heat_guard import heat_guard
from eval.bench.adversaries import adversaries
from eval.bench.attacked_faults import attacked_faults
from eval.bench.budget_check import budget_check
from eval.bench.estimation.estimate import estimate
from eval.bench.estimation.floating import floating
from eval.bench.kills import kills
from eval.bench.process import memory, startup
from eval.bench.reproducibility import reproducibility
from eval.bench.stages import stages
from eval.bench.stop_search import stop_search
from eval.bench.teleport import teleport
from eval.bench.throughput import throughput
from eval.bench.walk import walk
from robots.errors import ConfigError
from robots.spec import load_robot

console = plain_console(width=120)
HOURS_MAX = 100.0

BENCHES: dict[str, Callable[..., None]] = {
    "stages": stages,
    "throughput": throughput,
    "reproducibility": reproducibility,
    "kills": kills,
    "estimate": estimate,
    "floating": lambda spec, policy, console: floating(console),
    "ablation": ablation,
    "heat": heat_guard,
    "startup": startup,
    "memory": memory,
    "budget": budget_check,
    "teleport": teleport,
    "adversaries": adversaries,
    "faults": attacked_faults,
    "stops": stop_search,
    "walk": walk,
}
NOT_IN_ALL = ("kills", "adversaries", "faults", "walk")
"""The first takes most of an hour, the second hours, the third half an hour, the last a robot that walks."""
WITH_PICTURE, WITH_HOURS = ("estimate", "ablation", "teleport"), ("kills", "adversaries")


def bench(
    name: Annotated[
        str, typer.Argument(metavar="WHICH", help=f"One of {', '.join(BENCHES)}, or all.")
    ] = "all",
    policy: Annotated[Path, typer.Option(help="ONNX file from policy-export.")] = Path("out/arm.onnx"),
    robot: Annotated[str, typer.Option(help="Robot: a name or a folder.")] = "arm6",
    picture: Annotated[
        Path | None, typer.Option(help=f"PNG to draw, of {' or '.join(WITH_PICTURE)}.")
    ] = None,
    hours: Annotated[
        float | None,
        typer.Option(
            help=f"Simulated hours of each robot, of {' or '.join(WITH_HOURS)}.", show_default="0.09 or 1"
        ),
    ] = None,
) -> int:
    """Measure the figures in the README."""
    if name not in (*BENCHES, "all"):
        raise ConfigError(f"bench: found {name!r}, expected one of {', '.join(BENCHES)} or all")
    options: dict[str, Path | float] = {}
    for option, value, known in (("picture", picture, WITH_PICTURE), ("hours", hours, WITH_HOURS)):
        if value is not None and name not in known:
            raise ConfigError(f"bench: --{option} {value}: found {name!r}, expected {' or '.join(known)}")
        if value is not None:
            options[option] = value
    if hours is not None and not 0.0 < hours <= HOURS_MAX:
        raise ConfigError(f"bench: --hours {hours}: expected a number above 0 and at most {HOURS_MAX:g}")
    for line, measure in BENCHES.items():
        if name == line or (name == "all" and line not in NOT_IN_ALL):
            measure(load_robot(robot), policy, console, **options)
    return PASSED


if __name__ == "__main__":
    main(bench)
