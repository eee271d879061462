"""Table of benches, each of which measures some of the figures in the README.

python -m eval.bench stages            cost of a tick without physics, at several B, stage by stage
python -m eval.bench throughput        soak time ÷ bare physics time; a second worker; wider shards
python -m eval.bench reproducibility   equal results for any number of workers, and after an interruption
python -m eval.bench estimate          errors with and without the estimator, consistency, an outage
python -m eval.bench floating          errors of a floating base with and without its feet, consistency, cost
python -m eval.bench ablation          the same trial with one stage of the stack replaced
python -m eval.bench hot               the hottest motors in the hottest rooms, with the heat guard and without
python -m eval.bench start             time to the first tick of deploy-run, and its imports
python -m eval.bench memory            growth of a soak's memory
python -m eval.bench work              half an hour of 32 robots by the shipped budget; an idle policy that fails it
python -m eval.bench walk              a walking robot beside a bare loop: --robot FOLDER --policy FILE
python -m eval.bench                   all of them but the last
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from deploy.command_line import PASSED, main
from eval.bench.ablation.ablation import ablation
from eval.bench.ablation.hot import hot
from eval.bench.budget_check import work
from eval.bench.estimation.estimate import estimate
from eval.bench.estimation.floating import floating
from eval.bench.memory import memory
from eval.bench.reproducibility import reproducibility
from eval.bench.stages import stages
from eval.bench.startup import start
from eval.bench.throughput import throughput
from eval.bench.walk import walk
from robots.errors import ConfigError
from robots.spec import RobotSpec, load_robot

console = Console(width=120)

BENCHES: dict[str, Callable[[RobotSpec, Path, Path | None], None]] = {
    "stages": lambda spec, policy, _: stages(spec, policy, console),
    "throughput": lambda spec, policy, _: throughput(spec, policy, console),
    "reproducibility": lambda spec, policy, _: reproducibility(spec, policy, console),
    "estimate": lambda spec, policy, picture: estimate(spec, policy, console, picture),
    "floating": lambda spec, policy, _: floating(console),
    "ablation": lambda spec, policy, picture: ablation(spec, policy, console, picture),
    "hot": lambda spec, policy, _: hot(spec, policy, console),
    "start": lambda spec, policy, _: start(spec, policy, console),
    "memory": lambda spec, policy, _: memory(spec, policy, console),
    "work": lambda spec, policy, _: work(spec, policy, console),
    "walk": lambda spec, policy, _: walk(spec, policy, console),
}
WALKING_ROBOTS = ("walk",)
WITH_PICTURE = ("estimate", "ablation")


def bench(
    name: Annotated[
        str, typer.Argument(metavar="WHICH", help=f"One of {', '.join(BENCHES)}, or all.")
    ] = "all",
    policy: Annotated[Path, typer.Option(help="ONNX file from policy-export.")] = Path("out/arm.onnx"),
    robot: Annotated[str, typer.Option(help="Robot: a name or a folder.")] = "arm6",
    picture: Annotated[
        Path | None, typer.Option(help=f"PNG to draw, of {' or '.join(WITH_PICTURE)}.")
    ] = None,
) -> int:
    """Measure the figures in the README."""
    if name not in (*BENCHES, "all"):
        raise ConfigError(f"bench: found {name!r}, expected one of {', '.join(BENCHES)} or all")
    if picture is not None and name not in WITH_PICTURE:
        raise ConfigError(f"bench: --picture {picture}: found {name!r}, expected {' or '.join(WITH_PICTURE)}")
    spec = load_robot(robot)
    for line, measure in BENCHES.items():
        if name == line or (name == "all" and line not in WALKING_ROBOTS):
            measure(spec, policy, picture)
    return PASSED


def cli() -> None:
    """Entry point of `python -m eval.bench`."""
    main(bench)
