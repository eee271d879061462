"""Velocity: walk at the commanded velocity, one command after another."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from deploy.masks import any_true
from deploy.sources.floating_base import BASE
from deploy.sources.maximum import COMMAND, UNITY
from deploy.sources.source import ObservationSource
from deploy.state import Sample
from deploy.tasks.success import SuccessCriterion
from deploy.tasks.task import Task
from deploy.tasks.walking import WalkingTask, yaw
from deploy.truth import Truth
from robots.arrays import Floats
from robots.spec import RobotSpec

if TYPE_CHECKING:
    from deploy.runtime import Runtime

SPEED_TOLERANCE, TURN_TOLERANCE = 0.2, 0.3
"""m/s and rad/s by which the mean velocity over the ground and the mean rate of turning may miss the command."""


def command_error(achieved: Floats, goal: Floats) -> Floats:
    """(...,) largest error of velocity or turning rate (..., 3), as a multiple of its tolerance."""
    missed = achieved - goal
    speed = np.hypot(missed[..., 0], missed[..., 1]) / SPEED_TOLERANCE
    return np.maximum(speed, np.abs(missed[..., 2]) / TURN_TOLERANCE)


def _heading_error(runtime: "Runtime") -> Floats:
    """(B, 2) sine and cosine of the angle to the left from the heading to the commanded one."""
    task = runtime.task
    if not isinstance(task, Velocity):
        raise RuntimeError(f"task {task.name} commands no heading")
    turned = task.goal[:, 2] * task.elapsed * runtime.spec.dt
    error = task.heading + turned - yaw(runtime.base.quat_wxyz)
    return np.stack((np.sin(error), np.cos(error)), axis=1)


class Velocity(WalkingTask):
    """Commands of m/s forwards, m/s to the left and rad/s to the left, uniform in the robot's command range.

    Attributes:
        heading: (B,) rad, estimated heading when the present command was given. The commanded heading turns from there
            at the commanded rate.
    """

    name = "velocity"
    size = 3
    sources: ClassVar[Mapping[str, ObservationSource]] = {
        "velocity_command": ObservationSource(
            frame="base",
            unit="m/s, m/s, rad/s",
            size=3,
            sensing="none",
            maximum=COMMAND,
            read=lambda runtime: runtime.task.goal,
            meaning="command: forwards, to the left, turning to the left: operator",
        ),
        "heading_error": ObservationSource(
            frame="base",
            unit="1",
            size=2,
            sensing="proprioceptive",
            maximum=UNITY,
            read=_heading_error,
            meaning="sine and cosine of the angle to the left from the heading to the commanded one, which begins with"
            " each command where the robot heads and turns at the commanded rate: gyro and clock",
            sensors=("gyro", "accelerometer"),
            needs=BASE,
        ),
    }
    command: ClassVar[tuple[str, ...]] = ("velocity_command", "heading_error")
    observation: ClassVar[tuple[str, ...]] = (
        *("base_angular_velocity", "projected_gravity", "velocity_command"),
        *("joint_position", "joint_velocity", "last_action"),
    )
    carried: ClassVar[tuple[str, ...]] = (*Task.carried, "heading")

    def __init__(self, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence]) -> None:
        base = self.base_of(spec)
        self._low, self._high = np.array(base.command_min), np.array(base.command_max)
        self.heading = np.zeros(len(seeds))
        super().__init__(spec, seeds)

    @classmethod
    def success_criterion(cls, spec: RobotSpec) -> SuccessCriterion:
        """Mean velocity of the whole period within tolerance of the command."""
        return SuccessCriterion(
            size=3, period_s=cls.base_of(spec).command_s, tolerance=1.0, distance=command_error, mean=True
        )

    @classmethod
    def true_achieved(cls, truth: Truth) -> Floats:
        """(B, 3) velocity over the floor, along the heading and to its left, and turning rate about its normal."""
        base = truth.base
        if base is None:
            raise RuntimeError("task velocity: the robot has no floating base")
        heading, (w, x, y, z) = yaw(base.quat_wxyz), base.quat_wxyz.T
        cos, sin, (vx, vy, _) = np.cos(heading), np.sin(heading), base.velocity.T
        # The last row of the rotation: the upward part of each axis of the base.
        up = np.stack((2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)), axis=1)
        turning = (up * base.angular_velocity).sum(axis=1)
        return np.stack((cos * vx + sin * vy, cos * vy - sin * vx, turning), axis=1)

    def sample_goal(self, rng: np.random.Generator) -> Floats:
        """(3,) as `goal`."""
        return rng.uniform(self._low, self._high)

    def observe(self, runtime: "Runtime", sample: Sample, due: bool) -> None:
        """Read the estimated velocity of the base, and its heading where a command begins."""
        del sample, due
        if any_true(begins := self.elapsed == 0):
            self.heading[begins] = yaw(runtime.base.quat_wxyz[begins])
        self.achieved[:, :2] = runtime.base.velocity_in_base[:, :2]
        self.achieved[:, 2] = runtime.base.angular_velocity[:, 2]
