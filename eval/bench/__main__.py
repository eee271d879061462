"""make bench: every figure that the project promises, measured here and now.

python -m eval.bench stages     what a tick costs beside physics, at B = 64, 16 and 1, stage by stage
python -m eval.bench start      how soon deploy-run ticks, and what it imports
python -m eval.bench memory     whether a soak grows
python -m eval.bench            all of them
"""

import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

from deploy.backends.sim.robot import SimRobot
from deploy.cli import PASSED, main
from deploy.policy import Policy
from deploy.runtime import Runtime
from eval.bench.plain import plain_rate
from eval.bench.stopwatch import Stopwatch
from eval.monitors import Judge
from eval.shard import WIDTH, Shard, ShardJob
from robots.errors import ConfigError
from robots.model_mujoco import load_mujoco
from robots.model_pinocchio import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec, load_robot

WARM_S, ROUNDS = 2.0, 5
ROUND = {64: 100, 16: 300, 1: 2000}
"""Ticks of a round by number of robots."""
SEED = 7
PHYSICS = "physics (Batch.step)"
console = Console(width=100)


class Bench:
    """Runtime, simulated robots and judge in one process and one thread, every stage under a stopwatch."""

    def __init__(self, spec: RobotSpec, policy: Path, robots: int) -> None:
        """Arm B robots and let them work a while."""
        seeds = [robot_seed(SEED, robot) for robot in range(robots)]
        brain = Policy.load(policy, spec)
        self.robot = SimRobot(spec, seeds, threads=1)
        self.runtime = Runtime(spec, brain.contract, self.robot, seeds, brain)
        self.judge, self.watch, self.robots = Judge(spec, torque_max(spec), robots), Stopwatch(), robots
        self.runtime.start()
        self._watch(brain)
        self.run(round(WARM_S / spec.dt))
        self.watch.clear()

    def _watch(self, brain: Policy) -> None:
        runtime, plant = self.runtime, self.robot.plant
        stages: tuple[tuple[str, object, str], ...] = (
            ("whole tick", self, "tick"),
            (PHYSICS, plant.batch, "step"),
            ("plant: command, heat, truth", plant, "step"),
            ("sensors: take", self.robot.sensors, "take"),
            ("sensors: read", self.robot.sensors, "read"),
            ("estimator", runtime.estimator, "step"),
            ("observation", runtime.observation, "step"),
            ("policy", brain, "step"),
            ("action", runtime.action, "step"),
            ("smoother: next", runtime.smoother, "next"),
            ("smoother: stop ahead", runtime.smoother, "brake"),
            ("safety", runtime.safety, "step"),
            ("supervisor", runtime.supervisor, "step"),
            ("task", runtime.task, "step"),
            ("judge", self.judge, "step"),
        )
        for stage in stages:
            self.watch.watch(*stage)

    def tick(self) -> None:
        """One tick and its judgement, as a shard lives it."""
        runtime = self.runtime
        runtime.tick()
        self.judge.step(
            truth=self.robot.truth(),
            target=runtime.target,
            command=runtime.command,
            mode=runtime.supervisor.mode,
            reason=runtime.supervisor.reason,
            goal=runtime.task.goal,
            attempted=runtime.task.attempted,
        )

    def run(self, ticks: int) -> None:
        """Some ticks."""
        for _ in range(ticks):
            self.tick()


def stages(spec: RobotSpec, policy: Path) -> None:
    """Everything beside physics, stage by stage; the best of some rounds, since other work only adds time."""
    benches = {robots: Bench(spec, policy, robots) for robots in ROUND}
    tables = {robots: _best_round(bench, ROUND[robots]) for robots, bench in benches.items()}
    table = Table(
        "stage, µs per robot-tick", *(f"B = {robots}" for robots in tables), title="one process, one thread"
    )
    for name in tables[64]:
        table.add_row(name, *(f"{column[name]:.2f}" for column in tables.values()))
    for robots, column in tables.items():
        beside = sum(column.values()) - column[PHYSICS]
        console.print(f"B = {robots}: everything but physics ÷ physics = {beside / column[PHYSICS]:.3f}")
    console.print(table)
    _tick_without_physics(benches[1])
    _rates(spec, policy, tables)


def _best_round(bench: Bench, ticks: int) -> dict[str, float]:
    """µs per robot-tick of each stage in the round with the least total."""
    best: dict[str, float] = {}
    for _ in range(ROUNDS):
        bench.watch.clear()
        bench.run(ticks)
        scale = 1e6 / ticks / bench.robots
        spent = {name: bench.watch.total(name) * scale for name in bench.watch.samples}
        best = spent if not best or sum(spent.values()) < sum(best.values()) else best
    return best


def _tick_without_physics(bench: Bench) -> None:
    bench.watch.clear()
    began, whole = time.perf_counter, []
    physics = bench.watch.samples[PHYSICS]
    for _ in range(10_000):
        start = began()
        bench.tick()
        whole.append(began() - start)
    beside = 1e6 * (np.array(whole) - np.array(physics))
    median, p99 = np.percentile(beside, (50, 99))
    console.print(f"tick without physics at B = 1, judge included: median {median:.0f} µs, p99 {p99:.0f} µs")


def _rates(spec: RobotSpec, policy: Path, tables: dict[int, dict[str, float]]) -> None:
    """Robot-seconds per core-second: bare physics, this runtime, and the plain composition."""
    contract = Policy.load(policy, spec).contract
    table = Table("composition", "robot-seconds per core-second")
    table.add_row("bare physics, 64 robots", f"{_bare_physics(spec, 64):.0f}")
    for robots, column in tables.items():
        table.add_row(f"runtime and judge, {robots} robots", f"{1e6 * spec.dt / sum(column.values()):.0f}")
    table.add_row("plain composition, 1 robot", f"{plain_rate(spec, contract, policy, 600):.0f}")
    console.print(table)


def _bare_physics(spec: RobotSpec, robots: int) -> float:
    batch = Batch(load_mujoco(spec), robots, nthread=1)
    substeps, ticks = spec.rates.physics_hz // spec.rates.control_hz, 100
    batch.step(nstep=substeps)
    began = time.perf_counter()
    for _ in range(ticks):
        batch.step(nstep=substeps)
    return ticks * robots * spec.dt / (time.perf_counter() - began)


def start(spec: RobotSpec, policy: Path) -> None:
    """Time from the start of the process to the first tick of deploy-run, and whether torch came along."""
    script = (
        "import sys, time, deploy.runtime as r\n"
        "def tick(self, tick=r.Runtime.start):\n"
        "    tick(self)\n"
        "    print('torch' in sys.modules, flush=True)\n"
        "    raise KeyboardInterrupt\n"
        "r.Runtime.start = tick\n"
        "from deploy.run import cli\n"
        f"sys.argv = ['deploy-run', '--robot', {str(spec.folder)!r}, '--policy', {str(policy)!r}, '--duration', '1']\n"
        "cli()\n"
    )
    times = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as process:
            torch = process.stdout.readline().strip() if process.stdout else ""
            times.append(time.perf_counter() - began)
            process.kill()
    console.print(
        f"deploy-run: first tick after {np.median(times):.2f} s (median of {ROUNDS}); torch imported: {torch}"
    )


def memory(spec: RobotSpec, policy: Path) -> None:
    """Resident memory of a shard after one and after ten simulated minutes."""
    minute = round(60 / spec.dt)
    job = ShardJob(
        robot=spec.folder,
        policy=policy,
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


BENCHES: dict[str, Callable[[RobotSpec, Path], None]] = {"stages": stages, "start": start, "memory": memory}


def bench(
    which: Annotated[str, typer.Argument(help=f"One of {', '.join(BENCHES)}, or all.")] = "all",
    policy: Annotated[Path, typer.Option(help="ONNX file that policy-export wrote.")] = Path("out/arm.onnx"),
    robot: Annotated[str, typer.Option(help="Robot: a name or a folder.")] = "arm6",
) -> int:
    """Measure the figures that the project promises."""
    if which not in (*BENCHES, "all"):
        raise ConfigError(f"bench: found {which!r}, expected one of {', '.join(BENCHES)} or all")
    spec = load_robot(robot)
    for name, measure in BENCHES.items():
        if which in (name, "all"):
            measure(spec, policy)
    return PASSED


if __name__ == "__main__":
    main(bench)
