"""make bench: every figure that the project promises, measured here and now.

python -m eval.bench stages     what a tick costs beside physics, at several B, stage by stage
python -m eval.bench start      how soon deploy-run ticks, and what it imports
python -m eval.bench memory     whether a soak grows
python -m eval.bench work       an hour of 16 robots by the shipped budget, and an idle policy that fails it
python -m eval.bench            all of them
"""

import gc
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
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

from deploy.backends.sim.robot import SimRobot
from deploy.cli import PASSED, main
from deploy.policy import Policy
from deploy.runtime import Runtime
from eval.bench.idle import make_idle
from eval.bench.plain import plain_rate
from eval.bench.stopwatch import Stopwatch
from eval.budget import BUDGET, check, load_budget
from eval.counts import MONITORS, merge
from eval.monitors import Judge
from eval.shard import WIDTH, Shard, ShardJob, judge_tick
from eval.soak import Soak, run_soak
from robots.errors import ConfigError
from robots.model_mujoco import INPUTS, load_mujoco
from robots.model_pinocchio import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec, load_robot

WARM_S, ROUNDS = 2.0, 5
ROUND = {64: 200, 16: 400, WIDTH: 800, 1: 2000}
"""Ticks of a round by number of robots."""
TICKS = 10_000
"""Ticks of the distribution at one robot, which is the last of `ROUND`."""
SEED = 7
PHYSICS, TICK, JUDGE = "physics (Batch.rollout)", "rest of the tick", "judge"
console = Console(width=100)


class Bench:
    """Runtime, simulated robots and judge in one process and one thread, under a stopwatch."""

    def __init__(self, spec: RobotSpec, policy: Path, robots: int, *, every_stage: bool) -> None:
        """Arm B robots and let them work a while.

        Args:
            spec: the robot.
            policy: ONNX file.
            robots: B.
            every_stage: a stopwatch on each stage, which slows the tick; else on physics, tick and judge only.
        """
        seeds = [robot_seed(SEED, robot) for robot in range(robots)]
        brain = Policy.load(policy, spec)
        self.robot = SimRobot(spec, seeds, threads=1)
        self.runtime = Runtime(spec, brain.contract, self.robot, seeds, brain)
        self.judge, self.watch, self.robots = Judge(spec, torque_max(spec), robots), Stopwatch(), robots
        self._watch(brain if every_stage else None)
        self.tick()
        self.runtime.arm(np.ones(robots, dtype=bool))
        # Goals out of step, as in any hour of a shift but the first: or all would rest at once.
        period = round(self.runtime.task.config.period_s / spec.dt)
        self.runtime.task.elapsed[:] = np.arange(robots) * period // robots
        self.run(round(WARM_S / spec.dt))
        self.watch.clear()
        gc.collect()
        gc.freeze()  # as deploy-run

    def _watch(self, brain: Policy | None) -> None:
        runtime, plant = self.runtime, self.robot.plant
        self.watch.watch(JUDGE, self, "tick")
        self.watch.watch(TICK, runtime, "tick")
        self.watch.watch(PHYSICS, plant.batch, "rollout")
        if brain is None:
            return
        stages: tuple[tuple[str, object, str], ...] = (
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
        )
        for stage in stages:
            self.watch.watch(*stage)

    def tick(self) -> None:
        """One tick and its judgement, as a shard lives it."""
        self.runtime.tick()
        judge_tick(self.judge, self.robot, self.runtime)

    def run(self, ticks: int) -> None:
        """Some ticks."""
        for _ in range(ticks):
            self.tick()


def stages(spec: RobotSpec, policy: Path) -> None:
    """Everything beside physics, and where it goes; of some rounds the one with the median total."""
    whole, parts = {}, {}
    for robots, ticks in ROUND.items():
        bench = Bench(spec, policy, robots, every_stage=False)
        whole[robots] = _median_round(bench, ticks)
        parts[robots] = _median_round(Bench(spec, policy, robots, every_stage=True), ticks)
        beside = whole[robots][TICK] + whole[robots][JUDGE]
        console.print(
            f"B = {robots}: everything but physics ÷ physics = {beside / whole[robots][PHYSICS]:.3f}"
            f" ({beside:.1f} ÷ {whole[robots][PHYSICS]:.1f} µs per robot-tick)"
        )
    _tick_without_physics(bench)
    table = Table(
        "stage, µs per robot-tick", *(f"B = {robots}" for robots in parts), title="one process, one thread"
    )
    for name in parts[1]:
        table.add_row(name, *(f"{column[name]:.2f}" for column in parts.values()))
    console.print(table)
    _rates(spec, policy, whole)


def _median_round(bench: Bench, ticks: int) -> dict[str, float]:
    """µs per robot-tick of each stage in the round with the median total."""
    rounds = []
    for _ in range(ROUNDS):
        bench.watch.clear()
        bench.run(ticks)
        scale = 1e6 / ticks / bench.robots
        rounds.append({name: bench.watch.total(name) * scale for name in bench.watch.samples})
    return sorted(rounds, key=lambda spent: sum(spent.values()))[ROUNDS // 2]


def _tick_without_physics(bench: Bench) -> None:
    bench.watch.clear()
    bench.run(TICKS)
    median, p99 = 1e6 * np.percentile(bench.watch.samples[TICK], (50, 99))
    console.print(f"tick without physics at B = {bench.robots}: median {median:.0f} µs, p99 {p99:.0f} µs")


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
    batch.qpos = spec.joint_array("q_home")
    batch.ctrl = _holding(spec, batch.model.actuator_gear[:, 0])
    substeps, ticks = spec.rates.physics_hz // spec.rates.control_hz, 200
    batch.step(nstep=20 * substeps)
    began = time.perf_counter()
    for _ in range(ticks):
        batch.step(nstep=substeps)
    return ticks * robots * spec.dt / (time.perf_counter() - began)


def _holding(spec: RobotSpec, gear: np.ndarray) -> np.ndarray:
    """Controls of drives that hold the home pose."""
    controls = np.zeros((spec.n, INPUTS))
    controls[:, 0] = gear * spec.joint_array("q_home")
    return controls.ravel()


def start(spec: RobotSpec, policy: Path) -> None:
    """Time from the start of the process to the first tick of deploy-run, and whether torch came along."""
    script = (
        "import sys, deploy.runtime as r\n"
        "def act(self, action, act=r.Runtime.act):\n"
        "    act(self, action)\n"
        "    print(TAG, 'torch' in sys.modules, flush=True)\n"
        "r.Runtime.act, TAG = act, 'first tick, torch:'\n"
        "from deploy.run import cli\n"
        "cli()\n"
    )
    with tempfile.TemporaryDirectory() as out:
        options = ["--robot", str(spec.folder), "--policy", str(policy), "--duration", "1", "--out", out]
        starts = [_first_tick([sys.executable, "-c", script, *options]) for _ in range(ROUNDS)]
    times, torch = zip(*starts, strict=True)
    console.print(
        f"deploy-run: first tick after {np.median(times):.2f} s (median of {ROUNDS}, at most 3);"
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
    """An hour of 16 robots by the shipped budget, and three minutes of the same robots with an idle policy."""
    with tempfile.TemporaryDirectory() as folder:
        idle = make_idle(policy, Path(folder, "idle.onnx"))
        for path, hours in ((policy, 1.0), (idle, 0.05)):
            soak = Soak(
                spec=spec,
                policy=Policy.load(path, spec),
                policy_path=path,
                budget=BUDGET,
                hours=hours,
                robots=16,
                seed=SEED,
                workers=2,
            )
            counts = reduce(merge, (shard.counts for shard in run_soak(soak, console)))
            kept = all(finding.passed for finding in check(load_budget(), counts))
            hard = sum(counts.total(monitor.name) for monitor in MONITORS if monitor.hard)
            console.print(
                f"{path.name}, 16 robots x {hours:g} h: goals {100 * counts.goal_success:.2f} % (at least 97),"
                f" availability {100 * counts.availability:.2f} % (at least 99), hard events {hard} (at most 0):"
                f" budget {'kept' if kept else 'exceeded'}"
            )


BENCHES: dict[str, Callable[[RobotSpec, Path], None]] = {
    "stages": stages,
    "start": start,
    "memory": memory,
    "work": work,
}


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
