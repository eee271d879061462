"""Window of ticks that monitors are evaluated on, with the constants of the robot."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from deploy.policy.contract import Observed
from deploy.state import Mode
from eval.judge.limits import Limits
from eval.judge.singularity import SingularityMetric
from eval.judge.tick_buffer import PAST, Ticks
from robots.arrays import Bools, Floats
from robots.motors.drive_gains import drive_gains
from robots.spec import RobotSpec


@dataclass(frozen=True, kw_only=True)
class JudgedRobot:
    """Constants of one robot that limits and values of monitors are computed from.

    Attributes:
        torque_max: (n,) N·m, each actuator's range at the joint.
        limits: limits.toml.
        observed: statistics of the observations in training; None if the contract has none.
    """

    spec: RobotSpec
    torque_max: Floats
    limits: Limits
    observed: Observed | None

    @cached_property
    def q_middle(self) -> Floats:
        """(n,) rad, middle of the working range; home of a joint without ends."""
        return np.mean(self.spec.pose_range, axis=0)

    @cached_property
    def q_half_range(self) -> Floats:
        """(n,) rad, from the middle of the working range to its ends; infinite of a joint without them."""
        return (self.spec.joint_array("q_max") - self.spec.joint_array("q_min")) / 2

    @cached_property
    def stiffness(self) -> Floats:
        """(n,) N·m/rad, of the drives' own."""
        return drive_gains(self.spec).kp

    @cached_property
    def singularity(self) -> SingularityMetric:
        """Manipulability at true angles."""
        return SingularityMetric(self.spec)


class SentDifference(NamedTuple):
    """Backward difference of the angles sent.

    Attributes:
        judged: (T, R, n) in all ticks that the difference looks at the drive follows angles, or in all of them speeds.
        values: (T, R, n) rad.
    """

    judged: Bools
    values: Floats


class TickWindow:
    """Ticks to be judged, each beside the tick before it, and values that several monitors share.

    Attributes:
        robot: constants.
        ticks: (PAST + T, R, ...). now: (T, R, ...) the ticks to be judged. before: (T, R, ...) the tick before each.
        drives_on: (PAST + T, R) powered, and the simulation valid.
        drives_hold: (PAST + T, R, n) and they follow angles.
    """

    def __init__(self, ticks: Ticks, robot: JudgedRobot) -> None:
        self.robot, self.ticks = robot, ticks
        self.now, self.before = ticks.at(slice(PAST, None)), ticks.at(slice(PAST - 1, -1))
        self.drives_on = ticks.powered & ticks.valid
        self.drives_hold = self.drives_on[:, :, None] & (ticks.stiffness > 0.0)

    @cached_property
    def running(self) -> Bools:
        """(T, R) mode is RUNNING."""
        return self.now.mode == int(Mode.RUNNING)

    @cached_property
    def q_from_middle(self) -> Floats:
        """(T, R, n) rad, true angle from the middle of the working range."""
        return self.now.q - self.robot.q_middle

    @cached_property
    def joint_power(self) -> Floats:
        """(T, R, n) W, true mechanical power of each joint."""
        return self.now.tau * self.now.qd

    @cached_property
    def sent_differences(self) -> tuple[SentDifference, ...]:
        """First, second and third backward difference of the angles sent, or of the way at the speeds sent."""
        holds, values, found = self.drives_hold, np.diff(self.ticks.sent, axis=0), []
        judged = holds[1:] & holds[:-1]
        if not judged.all():
            rolls = self.drives_on[:, :, None] & ~holds & (self.ticks.damping > 0.0)
            rolled = rolls[1:] & rolls[:-1]
            np.copyto(values, self.robot.spec.dt * self.ticks.speed_sent[1:], where=rolled)
            judged |= rolled
        for order in range(1, PAST + 1):
            found.append(SentDifference(judged[PAST - order :], values[PAST - order :]))
            values, judged = np.diff(values, axis=0), judged[1:] & judged[:-1]
        return tuple(found)
