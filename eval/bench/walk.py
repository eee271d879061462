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
from deploy.estimation.rotations import matrix, matvec
from deploy.policy.contract import Contract
from deploy.policy.policy import Policy
from deploy.state import Mode
from deploy.tasks.velocity import Velocity
from eval.bench.stopwatch import Stopwatch
from eval.bench.trial import Trial
from eval.shard.job import ARM_S
from robots.arrays import Floats
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.errors import ConfigError
from robots.gains import Gains
from robots.models.nominal_model import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec
from robots.tables import Base

SEED, ROBOTS, WALKED_S = 7, 32, 60.0


class Walk(NamedTuple):
    """What came of some robots that walked under the whole stack.

    Attributes:
        forwards: (B,) m/s, mean over the ground in the direction in which the robot looks.
        lag: rad, how far what is sent is from what the policy wants; mean of joints while they ran, as below.
        velocity: m/s, error of the believed velocity of the base along one of its axes.
        joint_speed: rad/s, error of the believed speed of a joint.
        physics_s: s of a core that MuJoCo took; everything_s: with runtime and judge.
    """

    forwards: Floats
    lag: float
    velocity: float
    joint_speed: float
    physics_s: float
    everything_s: float


def walk(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Who falls, how fast they walk, and what it costs.

    Raises:
        ConfigError: the robot stands fixed, or the policy brings no gains.
    """
    brain = Policy.load(policy, spec)
    gains = brain.contract.action.gains
    if spec.base is None or gains is None:
        raise ConfigError(f"bench walk: --robot {spec.name}: found no base or no gains, expected both")
    table = Table(
        *(
            "",
            "stopped",
            "walked, m/s",
            "smoother behind, rad",
            "velocity off, m/s",
            "joint speed off, rad/s",
        ),
        title=f"{WALKED_S:g} s, asked for {spec.base.command_max[0]:g} m/s forwards",
    )
    forwards, fell, rate = _plain(spec, spec.base, brain, gains)
    table.add_row("a loop of the vendor's kind", f"{int(fell)} of 1", f"{forwards:.3f}", "", "", "")
    seeds = [robot_seed(SEED, robot) for robot in range(ROBOTS)]
    for name, given in (
        ("in the middle of their draws", median_draw(load_distributions(spec), spec, ROBOTS)),
        ("as drawn", None),
    ):
        trial = Trial(spec, policy, seeds, given=given)
        found = stroll(trial, WALKED_S)
        counts = trial.judge.counts()
        stopped = int((trial.runtime.supervisor.mode != Mode.RUNNING).sum())
        table.add_row(
            *(name, f"{stopped} of {ROBOTS}", f"{found.forwards.mean():.3f}"),
            *(f"{each:.3f}" for each in (found.lag, found.velocity, found.joint_speed)),
        )
    console.print(table)
    rest = (found.everything_s - found.physics_s) / found.physics_s
    console.print(
        f"everything but physics ÷ physics at B = {ROBOTS}: {rest:.2f}; robot-seconds per core-second:"
        f" {ROBOTS * WALKED_S / found.everything_s:.0f}, of that loop {rate:.0f};"
        f" robots touched themselves in {int(counts.total('self_collision'))} events"
    )


def stroll(trial: Trial, seconds: float) -> Walk:
    """Let armed robots walk and be judged; who has stopped counts with the speed that it has."""
    robot, runtime = trial.robot, trial.runtime
    watch, walked, many = Stopwatch(), np.zeros(robot.robots), 0
    off, moves = np.zeros((robot.robots, 3)), _moves(robot)
    watch.watch("physics", robot.plant.batch, "rollout")
    began, ticks = time.perf_counter(), round(seconds / runtime.spec.dt)
    armed = round(ARM_S / runtime.spec.dt)
    for tick, _ in enumerate(trial.live(ARM_S + seconds)):
        # What was believed in a tick is of its beginning.
        (_, velocity, qd), moves = moves, _moves(robot)
        base = runtime.state.base
        if tick < armed or base is None:
            continue
        walked += moves[0]
        errors = (
            runtime.target.q - runtime.setpoint.q,
            base.velocity_in_base - velocity,
            runtime.state.qd - qd,
        )
        ran = runtime.supervisor.mode == Mode.RUNNING
        off[ran] += np.stack([np.abs(error).mean(axis=1) for error in errors], axis=1)[ran]
        many += int(ran.sum())
    spent = time.perf_counter() - began
    lag, velocity_off, speed_off = off.sum(axis=0) / many
    return Walk(walked / ticks, lag, velocity_off, speed_off, watch.total("physics"), spent)


def _moves(robot: SimRobot) -> tuple[Floats, Floats, Floats]:
    """(B,) m/s forwards over the ground, (B, 3) m/s of the base in its own axes, (B, n) rad/s of the joints."""
    truth = robot.truth()
    if truth.base is None:
        raise ValueError(f"{robot.spec.name} stands fixed")
    velocity = matvec(matrix(truth.base.quat_wxyz).transpose(0, 2, 1), truth.base.velocity)
    return Velocity.true_achieved(truth)[:, 0], velocity, truth.qd.copy()


def _plain(spec: RobotSpec, base: Base, brain: Policy, gains: Gains) -> tuple[float, bool, float]:
    """One robot in a loop of that kind: m/s, whether it fell, robot-seconds per core-second."""
    robot = _Plain(spec, brain, gains)
    began, forwards, ticks = time.perf_counter(), 0.0, round(WALKED_S * spec.rates.control_hz)
    for tick in range(ticks):
        robot.tick(tick, np.array(base.command_max))
        forwards += robot.forwards()
    rate = WALKED_S / (time.perf_counter() - began)
    return forwards / ticks, robot.tilt() > base.tilt_max_rad, rate


class _Plain:
    """MuJoCo's own step in a loop, and gains."""

    def __init__(self, spec: RobotSpec, brain: Policy, gains: Gains) -> None:
        mjcf = mujoco.MjSpec.from_file(str(spec.model_path))
        mjcf.option.timestep = 1.0 / spec.rates.physics_hz
        mjcf.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
        for name, drive in zip(
            spec.joint_names, spec.drives, strict=False
        ):  # none where the model has its own
            joint = mjcf.joint(name)
            joint.armature = joint.armature or drive.armature
        self._model = mjcf.compile()
        self._data, self._brain, self._gains = mujoco.MjData(self._model), brain, gains
        self._data.qpos[7:] = spec.joint_array("q_home")
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
