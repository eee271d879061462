"""Attacks of situations: hostile policies, disturbances, sensor faults.

A policy returns actions (B, A), before clip and scale, at each policy step. A disturbance of the simulated robots is
called before each tick with the time in s.
"""

import numpy as np

from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.sensor_faults import Failure, Fault
from deploy.runtime import Runtime
from eval.faults.hostile_policy import HostilePolicy
from eval.mutants.situation import ROBOTS, Disturbance, SensorFaults
from eval.shard.hot_motors import heat_motors
from robots.arrays import Floats
from robots.sensors import Kind
from robots.spec import RobotSpec

JAMMED = 1e5
"""N·m of friction."""
FOREVER = 10**9
"""Ticks, longer than every situation."""


def sensor_faults(
    failure: Failure, at: float, *, sensor: Kind = "encoder", channel: int | None = None, ticks: int = FOREVER
) -> SensorFaults:
    """Return the faults of a sensor of every robot, from `at` s for a number of ticks, as a function of the spec."""

    def faults(spec: RobotSpec) -> tuple[Fault, ...]:
        begins = round(at * spec.rates.control_hz)
        return tuple(
            Fault(
                robot=robot, sensor=sensor, what=failure, channel=channel, begins=begins, ends=begins + ticks
            )
            for robot in range(ROBOTS)
        )

    return faults


def jam_joint(joint: int, at: float) -> Disturbance:
    """Jam a joint's gear from time `at`, s."""

    def disturb(runtime: Runtime, robot: SimRobot, t: float) -> None:
        if t >= at:  # set on every tick: wear changes friction too
            robot.plant.batch.expand("dof_frictionloss")[:, robot.plant.dofs[joint]] = JAMMED

    return disturb


def push_link(
    joint: int, axis: tuple[float, float, float], at: float, torque_nm: float, torque_rate: float
) -> Disturbance:
    """Apply an increasing torque, N·m and N·m/s, on a joint's link about an axis of the world, from time `at`, s."""

    def disturb(runtime: Runtime, robot: SimRobot, t: float) -> None:
        if t >= at:
            torque = (torque_nm + torque_rate * (t - at)) * np.array(axis)
            robot.plant.batch.bind("xfrc_applied")[:, robot.plant.bodies[joint], 3:] = torque

    return disturb


def slipping_brakes(share: float) -> Disturbance:
    """Limit the brakes to a share of the drives' torque, so that the arm sinks."""

    def disturb(runtime: Runtime, robot: SimRobot, t: float) -> None:
        limit, nominal = robot.plant.drives.torque_limit, robot.plant.drives.torque_limit_nominal
        limit[:] = nominal * np.where(runtime.supervisor.powered, 1.0, share)[:, None, None]

    return disturb


def encoder_offset_at_start(channel: int, rad: float) -> Disturbance:
    """Add an offset in rad to all packets of an encoder that are in transit at the start."""

    def disturb(runtime: Runtime, robot: SimRobot, t: float) -> None:
        if t == 0:
            robot.sensors.ring[:, :, channel] += rad
            robot.sensors.value[:, channel] += rad

    return disturb


def hot_motors_at_start(housing_c: float, rise_k: float) -> Disturbance:
    """Start with warm motors: housings at `housing_c`, windings warmer by `rise_k`, known to the runtime."""

    def disturb(runtime: Runtime, robot: SimRobot, t: float) -> None:
        if t == 0:
            every, joints = np.ones(robot.robots, dtype=bool), np.ones(runtime.spec.n)
            heat_motors(runtime, robot, every, housing_c * joints, rise_k * joints)

    return disturb


def move_to(**to: float) -> HostilePolicy:
    """Move the named joints to positions in rad as fast as allowed, and the others to the home pose."""

    def policy(runtime: Runtime) -> Floats:
        q = runtime.spec.joint_array("q_home").copy()
        for name, value in to.items():
            q[runtime.spec.joint_names.index(name)] = value
        return np.asarray((q - runtime.action.value) / runtime.contract.action.scale)

    return policy


def cycle_poses(every_s: float, *poses: dict[str, float]) -> HostilePolicy:
    """Move through poses cyclically, changing every `every_s` s."""
    each = [move_to(**pose) for pose in poses]
    return lambda runtime: each[int(runtime.t / every_s) % len(each)](runtime)


def switch_policy(t: float, first: HostilePolicy, second: HostilePolicy) -> HostilePolicy:
    """Use the first policy until `t` s, and then the second."""
    return lambda runtime: (first if runtime.t < t else second)(runtime)


def in_turn(*poses: tuple[float, dict[str, float]]) -> HostilePolicy:
    """Move to one pose after another, each from its time on, s, the first from 0."""
    each = [(begin, move_to(**pose)) for begin, pose in poses]
    return lambda runtime: [go for begin, go in each if begin <= runtime.t][-1](runtime)


def move_slowly_to(rad_s: float, **to: float) -> HostilePolicy:
    """Move to positions with limited speed, rad/s."""
    go = move_to(**to)

    def policy(runtime: Runtime) -> Floats:
        most = rad_s / runtime.contract.policy_hz / np.array(runtime.contract.action.scale)
        return np.clip(go(runtime), -most, most)

    return policy


def turn_last_joint(until: float) -> HostilePolicy:
    """Apply full action to the last joint until `until` s, and then none."""
    return lambda runtime: _last(runtime, float(runtime.t < until))


def action_spike(t: float, until: float, **near: float) -> HostilePolicy:
    """Move to positions; from `t` to `until` s apply an action of 100 (clip: 1) to the last joint, and then none."""
    go = move_to(**near)
    return lambda runtime: go(runtime) if runtime.t < t else _last(runtime, 100.0 * (runtime.t < until))


def nan_after(t: float, **to: float) -> HostilePolicy:
    """Move to positions; from `t` s on return NaN actions."""
    go = move_to(**to)
    return lambda runtime: np.full_like(runtime.action.last, np.nan) if runtime.t >= t else go(runtime)


def _last(runtime: Runtime, value: float) -> Floats:
    action = np.zeros_like(runtime.action.last)
    action[:, -1] = value
    return action
