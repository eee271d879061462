"""make bench: every figure that the project promises, measured here and now.

python -m eval.bench stages     what a tick costs beside physics, at several B, stage by stage
python -m eval.bench pace       how long a soak takes beside bare physics; a second worker, and wider shards
python -m eval.bench same       whether results depend on the number of workers, or on being cut short
python -m eval.bench estimate   errors with and without the estimator, its consistency, an outage
python -m eval.bench floating   errors of a floating base with and without its feet, consistency, cost
python -m eval.bench ablation   what each stage of the stack is worth: the same shift with one stage swapped
python -m eval.bench hot        the hottest motors in the hottest rooms, with the heat guard and without
python -m eval.bench start      how soon deploy-run ticks, and what it imports
python -m eval.bench memory     whether a soak grows
python -m eval.bench work       half an hour of 32 robots by the shipped budget, and an idle policy that fails it
python -m eval.bench walk       a robot that walks, beside a bare loop: --robot FOLDER --policy FILE
python -m eval.bench            all of them but the last
"""

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import reduce
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from deploy.command_line import PASSED, main
from deploy.policy.policy import Policy
from eval.bench.ablation import ablation
from eval.bench.estimation.estimate import estimate
from eval.bench.estimation.floating import floating
from eval.bench.hot import hot
from eval.bench.idle import make_idle
from eval.bench.pace import pace
from eval.bench.same import same
from eval.bench.stages import SEED, stages
from eval.bench.walk import walk
from eval.judge.counts import merge
from eval.judge.monitors import MONITORS
from eval.shard.job import WIDTH, ShardJob
from eval.shard.shard import Shard
from eval.soak.configuration import SoakConfig
from eval.soak.workers import run_soak
from eval.statistics.budget import BUDGET, check, load_budget
from robots.errors import ConfigError
from robots.spec import RobotSpec, load_robot

STARTS, WORKING = 5, 32

console = Console(width=120)


def start(spec: RobotSpec, policy: Path) -> None:
    """Time from the start of the process to the first tick of deploy-run, and whether torch came along."""
    script = (
        "import sys, deploy.runtime as r\n"
        "def act(self, action, act=r.Runtime.act):\n"
        "    act(self, action)\n"
        "    print(TAG, 'torch' in sys.modules, flush=True)\n"
        "r.Runtime.act, TAG = act, 'first tick, torch:'\n"
        "from deploy.operation.cli import cli\n"
        "cli()\n"
    )
    with tempfile.TemporaryDirectory() as out:
        options = ["--robot", str(spec.folder), "--policy", str(policy), "--duration", "1", "--out", out]
        starts = [_first_tick([sys.executable, "-c", script, *options]) for _ in range(STARTS)]
    times, torch = zip(*starts, strict=True)
    console.print(
        f"deploy-run: first tick after {np.median(times):.2f} s (median of {STARTS}, at most 3);"
        f" torch imported: {'yes' if any(torch) else 'no'}"
    )


def _first_tick(command: list[str]) -> tuple[float, bool]:
    """Seconds from the start of a process to the end of its first tick, and whether torch came along."""
    began = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout or ():
            if line.startswith("first tick, torch:"):
                spent = time.perf_counter() - began
                process.kill()
                return spent, line.split()[-1] == "True"
    raise RuntimeError("deploy-run ended without a tick")


def memory(spec: RobotSpec, policy: Path) -> None:
    """Resident memory of a shard after one and after ten simulated minutes."""
    minute = round(60 / spec.dt)
    job = ShardJob(
        robot=spec.folder,
        policy=policy,
        robot_digest=spec.digest,
        policy_digest=Policy.load(policy, spec).digest,
        seed=SEED,
        first=0,
        robots=WIDTH,
        ticks=10 * minute,
        sample_ticks=minute,
    )
    sizes: list[int] = []

    def look(ticks: int) -> None:
        if ticks % minute == 0:
            sizes.append(_resident_kib())

    Shard(job).run(look, lambda: False)
    console.print(
        f"memory of a shard of {WIDTH}: {sizes[0] / 1024:.1f} MiB after 1 simulated minute,"
        f" {sizes[-1] / 1024:.1f} MiB after {len(sizes)}"
    )


def _resident_kib() -> int:
    """KiB now, not the highest so far. Linux only: the other systems give the highest."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return pages * resource.getpagesize() // 1024


def work(spec: RobotSpec, policy: Path) -> None:
    """Half an hour of 32 robots by the shipped budget, and three minutes of the same robots with an idle policy."""
    with tempfile.TemporaryDirectory() as folder:
        idle = make_idle(policy, Path(folder, "idle.onnx"))
        for path, hours in ((policy, 0.5), (idle, 0.05)):
            soak = SoakConfig(
                spec=spec,
                policy=Policy.load(path, spec),
                policy_path=path,
                budget=BUDGET,
                hours=hours,
                robots=WORKING,
                seed=SEED,
                workers=2,
            )
            counts = reduce(
                merge, (shard.counts for shard in run_soak(soak, Path(folder, path.stem), console))
            )
            broken = ", ".join(line.name for line in check(load_budget(), counts) if not line.passed)
            hard = sum(counts.total(monitor.name) for monitor in MONITORS if monitor.hard)
            console.print(
                f"{path.name}, {WORKING} robots x {hours:g} h: goals {100 * counts.goal_success:.2f} % (at least 97),"
                f" availability {100 * counts.availability:.2f} % (at least 99), hard events {hard} (at most 0):"
                f" budget {f'exceeded by {broken}' if broken else 'kept'}"
            )


BENCHES: dict[str, Callable[[RobotSpec, Path, Path | None], None]] = {
    "stages": lambda spec, policy, _: stages(spec, policy, console),
    "pace": lambda spec, policy, _: pace(spec, policy, console),
    "same": lambda spec, policy, _: same(spec, policy, console),
    "estimate": lambda spec, policy, picture: estimate(spec, policy, console, picture),
    "floating": lambda spec, policy, _: floating(console),
    "ablation": lambda spec, policy, picture: ablation(spec, policy, console, picture),
    "hot": lambda spec, policy, _: hot(spec, policy, console),
    "start": lambda spec, policy, _: start(spec, policy),
    "memory": lambda spec, policy, _: memory(spec, policy),
    "work": lambda spec, policy, _: work(spec, policy),
    "walk": lambda spec, policy, _: walk(spec, policy, console),
}
OF_OTHER_ROBOTS = ("walk",)
PICTURED = ("estimate", "ablation")


def bench(
    which: Annotated[str, typer.Argument(help=f"One of {', '.join(BENCHES)}, or all.")] = "all",
    policy: Annotated[Path, typer.Option(help="ONNX file that policy-export wrote.")] = Path("out/arm.onnx"),
    robot: Annotated[str, typer.Option(help="Robot: a name or a folder.")] = "arm6",
    picture: Annotated[Path | None, typer.Option(help=f"PNG to draw, of {' or '.join(PICTURED)}.")] = None,
) -> int:
    """Measure the figures that the project promises."""
    if which not in (*BENCHES, "all"):
        raise ConfigError(f"bench: found {which!r}, expected one of {', '.join(BENCHES)} or all")
    if picture is not None and which not in PICTURED:
        raise ConfigError(f"bench: --picture {picture}: found {which!r}, expected {' or '.join(PICTURED)}")
    spec = load_robot(robot)
    for name, measure in BENCHES.items():
        if which == name or (which == "all" and name not in OF_OTHER_ROBOTS):
            measure(spec, policy, picture)
    return PASSED


if __name__ == "__main__":
    main(bench)
