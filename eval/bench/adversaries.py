"""Adversaries in velocity and torque mode: policies that ask for anything, against the guards and the judge.

Each control mode of the robot's drives but position is given a random policy and an adversarial one, at full scale: 16
drawn robots for an hour each.
"""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from deploy.backends.sim.robot import SimRobot
from deploy.policy.contract import Contract
from deploy.policy.contract_action import ActionSpec
from deploy.policy.contract_term import Term
from deploy.runtime import Runtime
from deploy.simulation import simulate
from deploy.tasks.task import tasks_of
from eval.bench.soak_setup import SEED
from eval.faults.hostile_policy import HostilePolicy, random_actions, shake_and_push
from eval.judge.counts import Counts
from eval.shard.job import ARM_S, POLL_S, WIDTH
from eval.shard.judging import judge_tick, make_judge
from eval.shard.shard import rearm
from robots.child_process import Lifeline, end_with
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from robots.randomness import robot_seed
from robots.spec import RobotSpec, load_robot

HOURS, WORKERS, POLICY_HZ = 1.0, 2, 50
COLUMNS = ("hard events", "stops", "in operation", "worst of limit")
PHASE_S, PUSH_S = 10.0, 2.0
"""s of shaking, then of pushing, and s of a push in one direction."""
REARM_S, HOME_S = 1.0, 10.0
"""s after which a robot without power is armed again, and after which it is put back to its home pose, where it may be
armed: each robot is stopped within seconds, and would rest for most of the time."""


class Case(NamedTuple):
    """One soak under an adversary."""

    robot: Path
    mode: ControlMode
    policy: str
    hours: float


POLICIES: dict[str, Callable[[], HostilePolicy]] = {
    "random": lambda: random_actions(SEED),
    "adversarial": lambda: shake_and_push(PHASE_S, PUSH_S, SEED),
}


def adversary_contract(spec: RobotSpec, mode: ControlMode) -> Contract:
    """Return a contract in a mode under which an action of 1 asks for the whole limit of a joint."""
    scale = spec.joint_array("qd_max") if mode is ControlMode.VELOCITY else torque_max(spec)
    angles = Term(
        name="q", source="joint_position", frame="joint", unit="rad", size=spec.n, scale=(1.0,) * spec.n
    )
    fields = {"mode": mode.name.lower(), "size": spec.n, "scale": tuple(scale), "clip": (-1.0, 1.0)}
    return Contract(
        robot=spec.name,
        robot_digest=spec.digest,
        joint_names=spec.joint_names,
        policy_hz=POLICY_HZ,
        control_hz=spec.rates.control_hz,
        task=tasks_of(spec)[0],
        observation=(angles,),
        action=ActionSpec.model_validate(fields),
        trained={"recipe": "adversary"},
    )


def restart(runtime: Runtime, robot: SimRobot) -> None:
    """Arm robots again, from their home pose if they cannot be armed where they are."""
    supervisor, home = runtime.supervisor, runtime.spec.joint_array("q_home")
    refused = ~supervisor.powered & (supervisor.since >= round(HOME_S / runtime.spec.dt))
    if refused.any():
        robot.reset(refused, np.tile(home, (robot.robots, 1)))
        runtime.reset(refused)
    rearm(runtime, REARM_S)


def run_case(case: Case) -> tuple[str, ...]:
    """Simulate one case and return its row of the table."""
    spec = load_robot(case.robot)
    contract, policy = adversary_contract(spec, case.mode), POLICIES[case.policy]()
    seeds = [robot_seed(SEED, robot) for robot in range(WIDTH)]
    runtime, robot = simulate(spec, contract, seeds)
    judge = make_judge(spec, contract, WIDTH)
    for tick in range(round(3600.0 * case.hours / spec.dt)):
        if tick == round(ARM_S / spec.dt):
            runtime.arm(np.ones(WIDTH, dtype=bool))
        if tick % round(POLL_S / spec.dt) == 0:
            restart(runtime, robot)
        action = None if runtime.sense() is None else policy(runtime)
        runtime.act(action)
        judge_tick(judge, robot.truth(), runtime, action)
    return _row(judge.counts())


def adversaries(spec: RobotSpec, policy: Path, console: Console, hours: float = HOURS) -> None:
    """Print hard events, availability and the worst limit ratios of every case, each when it is finished."""
    del policy
    modes = [mode for mode in spec.control_modes if mode is not ControlMode.POSITION]
    cases = [Case(spec.folder, mode, name, hours) for mode in modes for name in POLICIES]
    console.print(f"{spec.name}: {WIDTH} robots, {hours:g} h each: {len(cases)} cases, {WORKERS} at a time")
    with (
        Lifeline() as lifeline,
        ProcessPoolExecutor(WORKERS, get_context("spawn"), end_with, (lifeline.end,)) as pool,
    ):
        for case, row in zip(cases, pool.map(run_case, cases), strict=True):
            found = ", ".join(f"{what} {number}" for what, number in zip(COLUMNS, row, strict=True))
            console.print(f"{case.mode.name.lower()}, {case.policy}: {found}")


def _row(counts: Counts) -> tuple[str, ...]:
    hard = [monitor for monitor in counts.monitors if monitor.hard]
    found = {monitor.name: counts.total(monitor.name) for monitor in hard if counts.total(monitor.name)}
    worst = {m.name: float(counts.worst[:, counts.columns(m.name)].max()) for m in hard}
    highest = sorted(worst, key=lambda name: -worst[name])[:3]
    return (
        ", ".join(f"{name} {count}" for name, count in found.items()) or "0",
        str(int(counts.stops.sum())),
        f"{100 * counts.availability:.0f} %",
        ", ".join(f"{name} {worst[name]:.3f}" for name in highest),
    )
