"""What a tick costs beside physics, at several B, stage by stage, and the rates that follow."""

import gc
import time
from pathlib import Path

import numpy as np
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

from deploy.backends.sim.backend import simulate
from deploy.policy.policy import Policy
from eval.bench.plain import plain_rate
from eval.bench.stopwatch import Stopwatch
from eval.judge.judge import Judge
from eval.shard.job import ARM_S, WIDTH
from eval.shard.judging import judge_tick
from robots.models.mujoco_model import INPUTS, load_mujoco
from robots.models.nominal_model import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec

WARM_S, ROUNDS = 2.0, 15
ROUND = {64: 100, 16: 200, WIDTH: 400, 1: 1000}
"""Ticks of a round by number of robots."""
TICKS = 10_000
"""Ticks of the distribution at one robot, which is the last of `ROUND`."""
SEED = 7
PHYSICS, TICK, JUDGE = "physics (Batch.rollout)", "tick, between its stages", "judge"


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
        self.runtime, self.robot = simulate(spec, brain.contract, seeds, brain)
        rule, observed = self.runtime.task.rule, brain.contract.observed
        self.judge = Judge(spec, torque_max(spec), robots, scoring=rule, observed=observed)
        self.watch, self.robots = Stopwatch(), robots
        self._watch(brain if every_stage else None)
        self.run(round(ARM_S / spec.dt))
        self.runtime.arm(np.ones(robots, dtype=bool))
        # Goals out of step, as in any hour of a shift but the first: or all would rest at once.
        period = round(self.runtime.task.rule.period_s / spec.dt)
        self.runtime.task.elapsed[:] = np.arange(robots) * period // robots
        self.run(round(WARM_S / spec.dt))
        self.watch.clear()

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
        judge_tick(self.judge, self.robot.truth(), self.runtime, None)

    def run(self, ticks: int) -> None:
        """Some ticks, with what was built before them out of the garbage collector's sight, as in deploy-run."""
        gc.collect()
        gc.freeze()
        try:
            for _ in range(ticks):
                self.tick()
        finally:
            gc.unfreeze()


def stages(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Everything beside physics, and where it goes."""
    whole, parts = {}, {}
    for robots, ticks in ROUND.items():
        bench = Bench(spec, policy, robots, every_stage=False)
        whole[robots] = _medians(bench, ticks)
        parts[robots] = _medians(Bench(spec, policy, robots, every_stage=True), ticks)
        beside = whole[robots][TICK] + whole[robots][JUDGE]
        console.print(
            f"B = {robots}: everything but physics ÷ physics = {beside / whole[robots][PHYSICS]:.3f}"
            f" ({beside:.1f} ÷ {whole[robots][PHYSICS]:.1f} µs per robot-tick)"
        )
    _tick_without_physics(bench, console)
    table = Table(
        "stage, µs per robot-tick", *(f"B = {robots}" for robots in parts), title="one process, one thread"
    )
    for name in parts[1]:
        table.add_row(name, *(f"{column[name]:.2f}" for column in parts.values()))
    console.print(table)
    _rates(spec, policy, whole, console)


def _medians(bench: Bench, ticks: int) -> dict[str, float]:
    """µs per robot-tick of each stage: the median of some rounds, since other work may share the machine."""
    rounds = []
    for _ in range(ROUNDS):
        bench.watch.clear()
        bench.run(ticks)
        rounds.append([bench.watch.total(name) for name in bench.watch.samples])
    medians = np.median(rounds, axis=0) * 1e6 / ticks / bench.robots
    return dict(zip(bench.watch.samples, medians.tolist(), strict=True))


def _tick_without_physics(bench: Bench, console: Console) -> None:
    bench.watch.clear()
    bench.run(TICKS)
    median, p99 = 1e6 * np.percentile(bench.watch.samples[TICK], (50, 99))
    console.print(
        f"tick without physics and judge at B = {bench.robots}: median {median:.0f} µs, p99 {p99:.0f} µs"
    )


def _rates(spec: RobotSpec, policy: Path, tables: dict[int, dict[str, float]], console: Console) -> None:
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
