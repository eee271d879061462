"""Cost of a tick without physics, at several B, stage by stage, and the rates that follow."""

import gc
import time
from operator import attrgetter
from pathlib import Path

import numpy as np
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

from deploy.policy.policy import Policy
from eval.bench.baselines.library_loop import library_loop_rate
from eval.bench.soak_setup import SEED
from eval.bench.stopwatch import Stopwatch
from eval.bench.trial import Trial
from eval.shard.job import ARM_S, WIDTH
from robots.models.mujoco_model import INPUTS, load_mujoco
from robots.randomness import robot_seed
from robots.spec import RobotSpec

WARM_S, ROUNDS = 2.0, 15
ROUND = {64: 100, 16: 200, WIDTH: 400, 1: 1000}
"""Ticks of a round by number of robots."""
TICKS = 10_000
"""Ticks of the distribution at one robot, which is the last of `ROUND`."""
PHYSICS, TICK, JUDGE = "physics (Batch.rollout)", "tick, between its stages", "judge"
COARSE = ((TICK, "runtime", "tick"), (PHYSICS, "robot.plant.batch", "rollout"))
STAGES = (
    ("plant: command, heat, truth", "robot.plant", "step"),
    ("sensors: sample", "robot.sensors", "sample"),
    ("sensors: read", "robot.sensors", "read"),
    ("estimator", "runtime.estimator", "step"),
    ("observation", "runtime.observation", "step"),
    ("policy", "policy", "step"),
    ("action", "runtime.action", "step"),
    ("smoother: next", "runtime.smoother", "next"),
    ("smoother: stop ahead", "runtime.smoother", "brake"),
    ("safety", "runtime.safety", "step"),
    ("supervisor", "runtime.supervisor", "step"),
    ("task", "runtime.task", "step"),
)
"""Name, object in a trial, method."""


class StageBench(Trial):
    """Trial under a stopwatch."""

    def __init__(self, spec: RobotSpec, policy: Path, robots: int, *, every_stage: bool) -> None:
        """Arm B robots and run them for `WARM_S`.

        Timing every stage slows the tick; otherwise only physics, tick and judge are timed.
        """
        super().__init__(spec, policy, [robot_seed(SEED, robot) for robot in range(robots)])
        self.stopwatch, self.robots = Stopwatch(), robots
        self.stopwatch.watch(JUDGE, self, "tick")
        for name, owner, method in (*COARSE, *(STAGES if every_stage else ())):
            self.stopwatch.watch(name, attrgetter(owner)(self), method)
        self._start()

    def _start(self) -> None:
        self.run(round(ARM_S / self.runtime.spec.dt))
        self.runtime.arm(np.ones(self.robots, dtype=bool))
        # Goals out of step, as in any hour of a shift but the first. Otherwise all robots would rest at once.
        period = round(self.runtime.task.criterion.period_s / self.runtime.spec.dt)
        self.runtime.task.elapsed[:] = np.arange(self.robots) * period // self.robots
        self.run(round(WARM_S / self.runtime.spec.dt))
        self.stopwatch.clear()

    def run(self, ticks: int) -> None:
        """Run judged ticks, with older objects hidden from the garbage collector, as in deploy-run."""
        gc.collect()
        gc.freeze()
        try:
            for _ in range(ticks):
                self.tick()
        finally:
            gc.unfreeze()

    def medians(self, ticks: int) -> dict[str, float]:
        """Return µs per robot-tick of each stage: medians of rounds, since other work may share the machine."""
        rounds = []
        for _ in range(ROUNDS):
            self.stopwatch.clear()
            self.run(ticks)
            rounds.append([self.stopwatch.total(name) for name in self.stopwatch.samples])
        medians = np.median(rounds, axis=0) * 1e6 / ticks / self.robots
        return dict(zip(self.stopwatch.samples, medians.tolist(), strict=True))


def stages(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Print the cost of everything but physics, and of each stage."""
    coarse, fine = {}, {}
    for robots, ticks in ROUND.items():
        bench = StageBench(spec, policy, robots, every_stage=False)
        coarse[robots] = bench.medians(ticks)
        fine[robots] = StageBench(spec, policy, robots, every_stage=True).medians(ticks)
        other, physics = coarse[robots][TICK] + coarse[robots][JUDGE], coarse[robots][PHYSICS]
        console.print(
            f"B = {robots}: everything but physics ÷ physics = {other / physics:.3f}"
            f" ({other:.1f} ÷ {physics:.1f} µs per robot-tick)"
        )
    _print_tick_time(bench, console)
    _print_stages(fine, console)
    _print_rates(spec, policy, coarse, console)


def _print_tick_time(bench: StageBench, console: Console) -> None:
    bench.stopwatch.clear()
    bench.run(TICKS)
    median, p99 = 1e6 * np.percentile(bench.stopwatch.samples[TICK], (50, 99))
    console.print(
        f"tick without physics and judge at B = {bench.robots}: median {median:.0f} µs, p99 {p99:.0f} µs"
    )


def _print_stages(times: dict[int, dict[str, float]], console: Console) -> None:
    columns = (f"B = {robots}" for robots in times)
    table = Table("stage, µs per robot-tick", *columns, title="one process, one thread")
    for name in times[1]:
        table.add_row(name, *(f"{column[name]:.2f}" for column in times.values()))
    console.print(table)


def _print_rates(spec: RobotSpec, policy: Path, times: dict[int, dict[str, float]], console: Console) -> None:
    """Print robot-seconds per core-second of bare physics, this runtime, and plain library calls."""
    contract = Policy.load(policy, spec).contract
    table = Table("composition", "robot-seconds per core-second")
    table.add_row("bare physics, 64 robots", f"{_bare_physics_rate(spec, 64):.0f}")
    for robots, column in times.items():
        table.add_row(f"runtime and judge, {robots} robots", f"{1e6 * spec.dt / sum(column.values()):.0f}")
    table.add_row("plain library calls, 1 robot", f"{library_loop_rate(spec, contract, policy, 600):.0f}")
    console.print(table)


def _bare_physics_rate(spec: RobotSpec, robots: int) -> float:
    batch = Batch(load_mujoco(spec), robots, nthread=1)
    batch.qpos, controls = spec.joint_array("q_home"), np.zeros((spec.n, INPUTS))
    controls[:, 0] = batch.model.actuator_gear[:, 0] * spec.joint_array("q_home")
    batch.ctrl = controls.ravel()
    substeps, ticks = spec.rates.physics_hz // spec.rates.control_hz, 200
    batch.step(nstep=20 * substeps)
    began = time.perf_counter()
    for _ in range(ticks):
        batch.step(nstep=substeps)
    return ticks * robots * spec.dt / (time.perf_counter() - began)
