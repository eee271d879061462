"""Disturbances of simulated robots, called before each tick with the time in s."""

import numpy as np

from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.sensor_faults import Failure, Fault
from deploy.runtime import Runtime
from eval.mutants.situation import ROBOTS, Disturbance, SensorFaults
from robots.sensors import Kind
from robots.spec import RobotSpec

JAMMED = 1e5
"""N·m of friction."""


def sensor_faults(
    failure: Failure,
    at: float,
    *,
    sensor: Kind = "encoder",
    channel: int | None = None,
    until: float = 1e6,
) -> SensorFaults:
    """Return the faults of a sensor of every robot, from `at` to `until` in s, as a function of the spec."""

    def faults(spec: RobotSpec) -> tuple[Fault, ...]:
        begins, ends = (round(t * spec.rates.control_hz) for t in (at, until))
        return tuple(
            Fault(robot=robot, sensor=sensor, what=failure, channel=channel, begins=begins, ends=ends)
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
            robot.plant.housing[:] = housing_c
            robot.plant.housings.apply()
            robot.settle_sensors(np.ones(robot.robots, dtype=bool))
            rise = np.full(robot.plant.housing.shape, rise_k)
            robot.plant.warm(rise)
            runtime.estimator.windings.resume(rise, 0.0)

    return disturb
