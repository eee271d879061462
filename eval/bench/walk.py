"""A robot that walks: what the stack costs it beside a loop of its vendor's kind, and beside physics.

That loop knows the true state, sends the policy's targets as steps to drives that are nothing but their gains, has no
play in its gears, and filters, smooths, checks and judges nothing.
"""

import time
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from deploy.backends.sim.robot import SimRobot
from deploy.contract import Contract
from deploy.effort import Gains
from deploy.policy import Policy
from deploy.runtime import Runtime
from deploy.state import Floats, Mode
from eval.bench.stopwatch import Stopwatch
from eval.monitors import Judge, of_base
from eval.shard import ARM_S, judge_tick, rearm
from robots.errors import ConfigError
from robots.model_pinocchio import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec
from robots.tables import Base

SEED, ROBOTS, WALKED_S = 7, 32, 60.0


class Walked(NamedTuple):
    """What came of some robots that walked.

    Attributes:
        forwards: (B,) m/s, mean over the ground in the direction in which the robot looks.
        fell: (B,) whether it fell or stopped for good.
        rate: robot-seconds per core-second.
    """

    forwards: Floats
    fell: Floats
    rate: float


def walk(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Who falls, how fast they walk, and what it costs.

    Raises:
        ConfigError: the robot stands fixed, or the policy brings no gains.
    """
    brain = Policy.load(policy, spec)
    gains = brain.contract.action.gains
    if spec.base is None or gains is None:
        raise ConfigError(f"bench walk: --robot {spec.name}: found no base or no gains, expected both")
    theirs = _plain(spec, spec.base, brain, gains)
    ours, cost = _stack(spec, spec.base, brain)
    table = Table(
        *("", "walked, m/s", "fell or stopped for good", "robot-seconds per core-second"),
        title=f"{WALKED_S:g} s, asked for {spec.base.command_max[0]:g} m/s forwards",
    )
    for name, found in (
        ("a loop of the vendor's kind, the model as it is", theirs),
        (f"runtime and judge, {ROBOTS} draws", ours),
    ):
        table.add_row(name, f"{found.forwards.mean():.3f}", f"{int(found.fell.sum())}", f"{found.rate:.0f}")
    console.print(table)
    console.print(cost)


def _plain(spec: RobotSpec, base: Base, brain: Policy, gains: Gains) -> Walked:
    """One robot in a loop of that kind."""
    robot = _Plain(spec, brain, gains)
    began, forwards, ticks = time.perf_counter(), 0.0, round(WALKED_S * spec.rates.control_hz)
    for tick in range(ticks):
        robot.tick(tick, np.array(base.command_max))
        forwards += robot.forwards()
    spent = time.perf_counter() - began
    return Walked(
        np.array([forwards / ticks]), np.array([robot.tilt() > base.tilt_max_rad]), WALKED_S / spent
    )


class _Plain:
    """MuJoCo's own step in a loop, and gains."""

    def __init__(self, spec: RobotSpec, brain: Policy, gains: Gains) -> None:
        mjcf = mujoco.MjSpec.from_file(str(spec.model_path))
        mjcf.option.timestep = 1.0 / spec.rates.physics_hz
        mjcf.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
        self._model = mjcf.compile()
        self._data, self._brain, self._gains = mujoco.MjData(self._model), brain, gains
        self._torque_max, self._spec = torque_max(spec), spec
        self._act, self._last = np.zeros(spec.n), np.zeros(spec.n)
        brain.resize(1)

    def tick(self, tick: int, command: Floats) -> None:
        contract, spec, data = self._brain.contract, self._spec, self._data
        if tick % (contract.control_hz // contract.policy_hz) == 0:
            seen = self._observed(contract, tick * spec.dt, command)
            self._last = self._brain.step(seen.astype(np.float32))[0].astype(float)
        q_des = np.array(contract.action.offset) + np.array(contract.action.scale) * self._last
        for _ in range(spec.rates.physics_hz // spec.rates.control_hz):
            tau = self._gains.kp * (q_des - data.qpos[7:]) - self._gains.kd * data.qvel[6:]
            data.qfrc_applied[6:] = np.clip(tau, -self._torque_max, self._torque_max)
            mujoco.mj_step(self._model, data)

    def _observed(self, contract: Contract, t: float, command: Floats) -> Floats:
        data = self._data
        w, x, y, z = data.qpos[3:7]
        up = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
        phase = 2 * np.pi * t / contract.period_s
        velocity = np.zeros(3)
        mujoco.mju_rotVecQuat(velocity, data.qvel[:3], np.array([w, -x, -y, -z]))
        known = {
            "base_linear_velocity": velocity,
            "base_orientation": data.qpos[3:7],
            "base_angular_velocity": data.qvel[3:6],
            "projected_gravity": -up,
            "velocity_command": command,
            "joint_position": data.qpos[7:],
            "joint_velocity": data.qvel[6:],
            "last_action": self._last,
            "gait_phase": np.array([np.sin(phase), np.cos(phase)]),
        }
        terms = [
            (known[term.source] - np.array(term.offset or 0.0)) / term.scale for term in contract.observation
        ]
        return np.concatenate(terms)[None]

    def forwards(self) -> float:
        """m/s over the ground, where it looks."""
        w, x, y, z = self._data.qpos[3:7]
        heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return float(self._data.qvel[0] * np.cos(heading) + self._data.qvel[1] * np.sin(heading))

    def tilt(self) -> float:
        """Rad."""
        _, x, y, _ = self._data.qpos[3:7]
        return float(np.arccos(np.clip(1 - 2 * (x * x + y * y), -1, 1)))


def _stack(spec: RobotSpec, base: Base, brain: Policy) -> tuple[Walked, str]:
    """Robots as drawn under the whole stack, with judge."""
    seeds, everybody = [robot_seed(SEED, robot) for robot in range(ROBOTS)], np.ones(ROBOTS, dtype=bool)
    robot = SimRobot(spec, seeds, gains=brain.contract.action.gains)
    runtime = Runtime(spec, brain.contract, robot, seeds, brain)
    judge = Judge(spec, torque_max(spec), ROBOTS, goal_s=base.command_s)
    for _ in range(round(ARM_S / spec.dt)):
        runtime.tick()
    runtime.arm(everybody)
    watch, walked, ticks = Stopwatch(), np.zeros(ROBOTS), round(WALKED_S * spec.rates.control_hz)
    watch.watch("physics", robot.plant.batch, "rollout")
    began = time.perf_counter()
    for tick in range(ticks):
        runtime.tick()
        truth = robot.truth()
        judge_tick(judge, truth, runtime, None)
        walked += of_base(truth.base)[0][:, 0] if truth.base else 0.0
        if tick < ticks // 10:
            rearm(runtime, 0.0)  # who was refused at first, for a sensor's noise
    spent = time.perf_counter() - began
    physics = watch.total("physics")
    fell = runtime.supervisor.mode == Mode.LATCHED
    cost = (
        f"everything but physics ÷ physics at B = {ROBOTS}: {(spent - physics) / physics:.2f};"
        f" robots touched themselves in {int(judge.counts().total('self_collision'))} events"
    )
    return Walked(walked / ticks, fell, ROBOTS * WALKED_S / spent), cost
