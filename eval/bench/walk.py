"""Cost of the stack for a walking robot, beside a bare vendor loop and beside physics."""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from deploy.backends.sim.robot import SimRobot
from deploy.policy.policy import Policy
from deploy.state import Mode
from deploy.tasks.velocity import Velocity
from eval.bench.baselines.vendor_loop import run_vendor_loop
from eval.bench.stopwatch import Stopwatch
from eval.bench.trial import Trial
from eval.shard.job import ARM_S
from robots.arrays import Floats
from robots.capabilities import required
from robots.distributions import load_distributions
from robots.draws import Draw, median_draw
from robots.errors import ConfigError
from robots.randomness import robot_seed
from robots.rotations import matrix, matvec
from robots.spec import RobotSpec

SEED, ROBOTS, WALK_S = 7, 32, 60.0
COLUMNS = (
    *("", "stopped", "speed, m/s", "smoother lag, rad", "velocity error, m/s"),
    "joint speed error, rad/s",
)


class WalkResult(NamedTuple):
    """Speed, errors and cost of B walking robots under the whole stack.

    Attributes:
        forward_speed: (B,) m/s, mean over the ground in the robot's heading.
        smoother_lag: rad, target minus setpoint. It and the next two are mean absolute values while running.
        velocity_error: m/s, of the estimated base velocity along one of its axes.
        joint_speed_error: rad/s, of the estimated joint speed.
        physics_s: s of a core spent in MuJoCo. total_s: with runtime and judge.
    """

    forward_speed: Floats
    smoother_lag: float
    velocity_error: float
    joint_speed_error: float
    physics_s: float
    total_s: float


def walk(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Print falls, speed, errors and cost: vendor loop, median draw, random draws.

    Raises:
        ConfigError: the robot has no floating base, or the policy has no gains.
    """
    loaded = Policy.load(policy, spec)
    gains = loaded.contract.action.gains
    if "floating_base" not in spec.capabilities or gains is None:
        raise ConfigError(f"bench walk: --robot {spec.name}: found no base or no gains, expected both")
    command = required(spec.base).command_max[0]
    table = Table(*COLUMNS, title=f"{WALK_S:g} s, commanded {command:g} m/s forwards")
    speed, fell, loop_rate = run_vendor_loop(spec, loaded, gains, WALK_S)
    table.add_row("vendor loop", f"{int(fell)} of 1", f"{speed:.3f}", "", "", "")
    median = median_draw(load_distributions(spec), spec, ROBOTS)
    _add_row(table, "median draw", spec, policy, median)
    trial, result = _add_row(table, "random draws", spec, policy, None)
    console.print(table)
    ratio = (result.total_s - result.physics_s) / result.physics_s
    console.print(
        f"everything but physics ÷ physics at B = {ROBOTS}: {ratio:.2f}; robot-seconds per core-second:"
        f" {ROBOTS * WALK_S / result.total_s:.0f}, of the vendor loop {loop_rate:.0f};"
        f" self-collisions: {int(trial.judge.counts().total('self_collision'))} events"
    )


def _add_row(
    table: Table, name: str, spec: RobotSpec, policy: Path, draw: Draw | None
) -> tuple[Trial, WalkResult]:
    trial = Trial(spec, policy, [robot_seed(SEED, robot) for robot in range(ROBOTS)], draw=draw)
    result = measure_walk(trial, WALK_S)
    stopped = int((trial.runtime.supervisor.mode != Mode.RUNNING).sum())
    errors = result.smoother_lag, result.velocity_error, result.joint_speed_error
    cells = (f"{value:.3f}" for value in (result.forward_speed.mean(), *errors))
    table.add_row(name, f"{stopped} of {ROBOTS}", *cells)
    return trial, result


def measure_walk(trial: Trial, seconds: float) -> WalkResult:
    """Run a trial and measure its walk; a stopped robot counts with its actual speed."""
    robot, runtime = trial.robot, trial.runtime
    stopwatch, forward, running_ticks = Stopwatch(), np.zeros(robot.robots), 0
    errors, motion = np.zeros((robot.robots, 3)), _true_motion(robot)
    stopwatch.watch("physics", robot.plant.batch, "rollout")
    began, ticks = time.perf_counter(), round(seconds / runtime.spec.dt)
    armed = round(ARM_S / runtime.spec.dt)
    for tick, _ in enumerate(trial.advance(ARM_S + seconds)):
        # Estimates of a tick belong to its beginning.
        (_, velocity, qd), motion = motion, _true_motion(robot)
        if tick < armed:
            continue
        forward += motion[0]
        differences = (
            runtime.target.value - runtime.setpoint.q,
            required(runtime.state.base).velocity_in_base - velocity,
            runtime.state.qd - qd,
        )
        running = runtime.supervisor.mode == Mode.RUNNING
        means = [np.abs(difference).mean(axis=1) for difference in differences]
        errors[running] += np.stack(means, axis=1)[running]
        running_ticks += int(running.sum())
    spent = time.perf_counter() - began
    lag, velocity_error, speed_error = errors.sum(axis=0) / running_ticks
    return WalkResult(forward / ticks, lag, velocity_error, speed_error, stopwatch.total("physics"), spent)


def _true_motion(robot: SimRobot) -> tuple[Floats, Floats, Floats]:
    """(B,) m/s forwards over the ground, (B, 3) m/s of the base in its own axes, (B, n) rad/s of the joints."""
    truth = robot.truth()
    base = required(truth.base)
    velocity = matvec(matrix(base.quat_wxyz).transpose(0, 2, 1), base.velocity)
    return Velocity.true_achieved(truth)[:, 0], velocity, truth.qd.copy()
