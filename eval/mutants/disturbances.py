"""What befalls robots: called before each tick with the s since the start."""

import numpy as np

from deploy.backends.sim.robot import SimRobot
from deploy.backends.sim.sensor_faults import Failure, Fault
from deploy.runtime import Runtime
from eval.mutants.situation import ROBOTS, Disturbance
from robots.sensors import Kind

JAMMED = 1e5
"""N·m of friction."""


def sensor_faults(
    what: Failure,
    at: float,
    control_hz: int,
    *,
    sensor: Kind = "encoder",
    channel: int | None = None,
    until: float = 1e6,
) -> tuple[Fault, ...]:
    """A sensor fails from s to s, on every robot."""
    begins, ends = round(at * control_hz), round(until * control_hz)
    return tuple(
        Fault(robot=robot, sensor=sensor, what=what, channel=channel, begins=begins, ends=ends)
        for robot in range(ROBOTS)
    )


def apply_all(*befalls: Disturbance) -> Disturbance:
    """One after the other, before the same tick."""

    def befall(runtime: Runtime, robot: SimRobot, t: float) -> None:
        for each in befalls:
            each(runtime, robot, t)

    return befall


def jam_joint(joint: int, at: float) -> Disturbance:
    """A joint's gear jams."""

    def befall(runtime: Runtime, robot: SimRobot, t: float) -> None:
        if t >= at:  # anew each time: wear writes friction too
            robot.plant.batch.expand("dof_frictionloss")[:, robot.plant.dofs[joint]] = JAMMED

    return befall


def push_link(
    joint: int, axis: tuple[float, float, float], at: float, newton_metres: float, per_s: float
) -> Disturbance:
    """Something leans on a joint's link, ever harder, by a torque about an axis of the world."""

    def befall(runtime: Runtime, robot: SimRobot, t: float) -> None:
        if t >= at:
            torque = (newton_metres + per_s * (t - at)) * np.array(axis)
            robot.plant.batch.bind("xfrc_applied")[:, robot.plant.pushes.bodies[joint], 3:] = torque

    return befall


def slipping_brakes(share: float) -> Disturbance:
    """Brakes that slip: they hold with this share of the drives' torque, and the arm sinks."""

    def befall(runtime: Runtime, robot: SimRobot, t: float) -> None:
        limit, nominal = robot.plant.drives.torque_limit, robot.plant.drives.torque_limit_nominal
        limit[:] = nominal * np.where(runtime.supervisor.powered, 1.0, share)[:, None, None]

    return befall


def encoder_offset_at_start(channel: int, rad: float) -> Disturbance:
    """All that an encoder has on its way when the robot is switched on is wrong."""

    def befall(runtime: Runtime, robot: SimRobot, t: float) -> None:
        if t == 0:
            robot.sensors.ring[:, :, channel] += rad
            robot.sensors.value[:, channel] += rad

    return befall


def hot_motors_at_start(housing_c: float, rise_k: float) -> Disturbance:
    """Motors have worked before: housings at so many °C, windings warmer by so many K, and the runtime knows it."""

    def befall(runtime: Runtime, robot: SimRobot, t: float) -> None:
        if t == 0:
            robot.plant.housing[:] = housing_c
            robot.plant.housings.apply()
            robot.settle_sensors(np.ones(robot.robots, dtype=bool))
            rise = np.full(robot.plant.housing.shape, rise_k)
            robot.warm(rise)
            runtime.estimator.windings.resume(rise, 0.0)

    return befall
