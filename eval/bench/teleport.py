"""Demonstration: a policy that teleports in position mode, under drives as simulators and robots have them.

The policy asks one joint for two far angles in turns. A motor without limits obeys at once, a real one saturates; with
the action's cap on the change of a target, and through the whole runtime, the motion is one that the robot can do.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from deploy.backends.sim.model.motor_parameters import VOLTAGE_MAX
from deploy.policy.action import Action
from deploy.policy.contract import Contract
from deploy.policy.contract_action import ActionSpec
from deploy.policy.contract_term import Term
from deploy.simulation import simulate
from deploy.state import DriveMode
from deploy.tasks.task import tasks_of
from deploy.telemetry.output_files import replacing
from robots.arrays import Floats
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.models.mujoco_model import INPUTS, load_mujoco
from robots.models.nominal_model import torque_max
from robots.randomness import robot_seed
from robots.spec import RobotSpec

SECONDS, POLICY_HZ, HALF_PERIOD_S, ARMING_S = 1.2, 50, 0.1, 0.4
SHARE, CAP = 0.6, 0.02
"""Share of half the working range that the policy asks for, either way; rad that a target may change in a step."""
LIMIT_COLOUR, COLOURS = "#b2182b", ("#1f5f8b", "#c9743a", "#3a7d44", "#6a4c93")


class Motion(NamedTuple):
    """One joint over time: (T,) s, rad, rad, rad/s, N·m."""

    t: Floats
    target: Floats
    q: Floats
    qd: Floats
    tau: Floats


def teleport(spec: RobotSpec, policy: Path, console: Console, picture: Path | None = None) -> None:
    """Print speed and torque of every variant as shares of their limits; draw `picture` if given."""
    del policy
    motions = {name: variant(spec) for name, variant in VARIANTS.items()}
    qd_max, tau_max = spec.joints[0].qd_max, float(torque_max(spec)[0])
    table = Table(
        "", "speed of limit", "torque of range", "s at the end of the range", title=spec.joints[0].name
    )
    for name, motion in motions.items():
        speed, torque = np.abs(motion.qd).max() / qd_max, np.abs(motion.tau) / tau_max
        saturated = (torque > 0.999).mean() * SECONDS
        table.add_row(name, f"{speed:.2f}", f"{torque.max():.2f}", f"{saturated:.2f}")
    console.print(table)
    if picture is not None:
        with replacing(picture) as file:
            draw(spec, motions, file)


def _action(spec: RobotSpec, tick: int) -> Floats:
    """(1, n) the policy's action: the first joint to one side and to the other, in turns."""
    action = np.zeros((1, spec.n))
    action[0, 0] = SHARE * (-1.0) ** int(tick * spec.dt / HALF_PERIOD_S)
    return action


def _action_spec(spec: RobotSpec, change_max: float | None) -> ActionSpec:
    low, high = spec.joint_array("q_min"), spec.joint_array("q_max")
    return ActionSpec(
        mode="position",
        size=spec.n,
        offset=tuple(spec.joint_array("q_home")),
        scale=tuple((high - low) / 2),
        clip=(-1.0, 1.0),
        change_max=None if change_max is None else (change_max,) * spec.n,
    )


def _drives_alone(spec: RobotSpec, *, limited: bool, change_max: float | None) -> Motion:
    """Simulate MuJoCo's model of the robot whose drives follow targets as they come."""
    model = load_mujoco(spec)
    if not limited:
        model.jnt_actfrclimited[:] = model.actuator_forcelimited[:] = False
        model.actuator_gainprm[:, VOLTAGE_MAX] = 0.0  # no highest voltage
    data, gear = mujoco.MjData(model), model.actuator_gear[:, 0]
    data.qpos[:] = home = spec.joint_array("q_home")
    target = Action(
        _action_spec(spec, change_max), DriveMode(np.zeros(1, dtype=np.int64), *np.zeros((2, 1, spec.n)))
    )
    target.reset(np.ones(1, dtype=bool), home[None])
    rows = []
    for tick in range(round(SECONDS * spec.rates.control_hz)):
        if tick % (spec.rates.control_hz // POLICY_HZ) == 0:
            target.step(_action(spec, tick), home[None])
        data.ctrl.reshape(spec.n, INPUTS)[:, 0] = target.value[0] * gear
        for _ in range(spec.rates.physics_hz // spec.rates.control_hz):
            mujoco.mj_step(model, data)
        rows.append((tick * spec.dt, target.value[0, 0], data.qpos[0], data.qvel[0], data.qfrc_actuator[0]))
    return Motion(*np.array(rows).T)


def _whole_runtime(spec: RobotSpec) -> Motion:
    """Simulate the runtime on the median robot: the same policy without a cap."""
    term = Term(
        name="q", source="joint_position", frame="joint", unit="rad", size=spec.n, scale=(1.0,) * spec.n
    )
    contract = Contract(
        robot=spec.name,
        robot_digest=spec.digest,
        joint_names=spec.joint_names,
        policy_hz=POLICY_HZ,
        control_hz=spec.rates.control_hz,
        task=tasks_of(spec)[0],
        observation=(term,),
        action=_action_spec(spec, None),
        trained={"recipe": "teleport"},
    )
    draw = median_draw(load_distributions(spec), spec, 1)
    runtime, robot = simulate(spec, contract, [robot_seed(0, 0)], draw=draw)
    rows, arming = [], round(ARMING_S / spec.dt)
    for tick in range(-arming, round(SECONDS / spec.dt)):
        due = runtime.sense() is not None
        if tick == -arming // 2:
            runtime.arm(np.ones(1, dtype=bool))
        action = _action(spec, tick) if tick >= 0 else np.zeros((1, spec.n))
        runtime.act(action if due else None)
        truth = robot.truth()
        rows.append(
            (tick * spec.dt, runtime.target.value[0, 0], truth.q[0, 0], truth.qd[0, 0], truth.tau[0, 0])
        )
    return Motion(*np.array(rows)[arming:].T)


VARIANTS: dict[str, Callable[[RobotSpec], Motion]] = {
    "motor without limits": lambda spec: _drives_alone(spec, limited=False, change_max=None),
    "real motor": lambda spec: _drives_alone(spec, limited=True, change_max=None),
    "real motor, target capped": lambda spec: _drives_alone(spec, limited=True, change_max=CAP),
    "firstshift's runtime": _whole_runtime,
}


def draw(spec: RobotSpec, motions: dict[str, Motion], file: Path) -> None:
    """Draw a column for each variant: angle, speed and torque of the joint, as a PNG."""
    joint, tau_max = spec.joints[0], float(torque_max(spec)[0])
    with mpl.rc_context({"font.size": 8.5, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(11, 5.4), layout="constrained")
        panels = figure.subplots(3, len(motions), sharex=True, sharey="row")
        for column, (name, motion), colour in zip(panels.T, motions.items(), COLOURS, strict=True):
            column[0].set_title(name, loc="left")
            column[0].plot(motion.t, motion.target, color="#999999", linewidth=1.0, drawstyle="steps-post")
            for axes, values, limit in zip(column, motion[2:], (None, joint.qd_max, tau_max), strict=True):
                _panel(axes, motion.t, values, colour, limit)
            column[2].set_xlabel("s")
        for axes, label in zip(
            panels[:, 0], ("angle (grey: target), rad", "speed, rad/s", "torque, N·m"), strict=True
        ):
            axes.set_ylabel(label)
        panels[1, 0].set_ylim(-4 * joint.qd_max, 4 * joint.qd_max)
        panels[2, 0].set_ylim(-2 * tau_max, 2 * tau_max)
        figure.savefig(file, dpi=110, format="png")


def _panel(axes: Axes, t: Floats, values: Floats, colour: str, limit: float | None) -> None:
    axes.plot(t, values, color=colour, linewidth=1.3)
    axes.grid(visible=True, color="#e4e4e4", linewidth=0.6)
    for sign in (1.0, -1.0) if limit else ():
        axes.axhline(sign * (limit or 0.0), color=LIMIT_COLOUR, linewidth=0.8, linestyle="--")
