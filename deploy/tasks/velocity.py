"""Velocity: walk at the commanded velocity, one command after another."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from deploy.observation_sources import BASE, ObservationSource
from deploy.state import Sample
from deploy.tasks.success import SuccessCriterion
from deploy.tasks.task import Task
from deploy.truth import Truth
from robots.arrays import Bools, Floats
from robots.capabilities import Capability
from robots.errors import RobotError
from robots.spec import RobotSpec
from robots.tables import Base

if TYPE_CHECKING:
    from deploy.runtime import Runtime

SPEED_TOLERANCE, TURN_TOLERANCE = 0.2, 0.3
"""m/s and rad/s by which the mean velocity over the ground and the mean rate of turning may miss the command."""


def command_error(achieved: Floats, goal: Floats) -> Floats:
    """(...,) largest error of velocity or turning rate (..., 3), as a multiple of its tolerance."""
    missed = achieved - goal
    speed = np.hypot(missed[..., 0], missed[..., 1]) / SPEED_TOLERANCE
    return np.maximum(speed, np.abs(missed[..., 2]) / TURN_TOLERANCE)


class Velocity(Task):
    """Commands of m/s forwards, m/s to the left and rad/s to the left, uniform in the robot's command range."""

    name = "velocity"
    size = 3
    needs: ClassVar[frozenset[Capability]] = BASE
    sources: ClassVar[Mapping[str, ObservationSource]] = {
        "velocity_command": ObservationSource(
            "base", "m/s, m/s, rad/s", 3, lambda r: r.task.goal, "operator"
        ),
    }

    def __init__(self, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence]) -> None:
        base = _base(spec)
        self._low, self._high = np.array(base.command_min), np.array(base.command_max)
        super().__init__(spec, seeds)

    @classmethod
    def success_criterion(cls, spec: RobotSpec) -> SuccessCriterion:
        """Mean velocity of the whole period within tolerance of the command."""
        return SuccessCriterion(
            size=3, period_s=_base(spec).command_s, tolerance=1.0, distance=command_error, mean=True
        )

    @classmethod
    def limit_goal_period(cls, spec: RobotSpec, period_s: float) -> RobotSpec:
        """Return the robot with commands of at most `period_s` s."""
        base = _base(spec)
        shorter = base.model_copy(update={"command_s": min(base.command_s, period_s)})
        return spec.model_copy(update={"base": shorter})

    @classmethod
    def true_achieved(cls, truth: Truth) -> Floats:
        """(B, 3) velocity over the floor, along the heading and to its left, and turning rate about its normal."""
        base = truth.base
        if base is None:
            raise RuntimeError("task velocity: the robot has no floating base")
        w, x, y, z = base.quat_wxyz.T
        # The first column of the rotation: the base's x axis in the world.
        heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        cos, sin, (vx, vy, _) = np.cos(heading), np.sin(heading), base.velocity.T
        # The last row of the rotation: the upward part of each axis of the base.
        up = np.stack((2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)), axis=1)
        turning = (up * base.angular_velocity).sum(axis=1)
        return np.stack((cos * vx + sin * vy, cos * vy - sin * vx, turning), axis=1)

    def sample_goal(self, rng: np.random.Generator) -> Floats:
        """(3,) as `goal`."""
        return rng.uniform(self._low, self._high)

    def observe(self, runtime: "Runtime", sample: Sample, due: bool) -> None:
        """Read the estimated velocity of the base."""
        del sample, due
        self.achieved[:, :2] = runtime.base.velocity_in_base[:, :2]
        self.achieved[:, 2] = runtime.base.angular_velocity[:, 2]

    def arm(self, ids: Bools) -> None:
        """Begin a new command: a robot without power cannot follow one."""
        self.reset(ids)


def _base(spec: RobotSpec) -> Base:
    if spec.base is None:
        raise RobotError(f"{spec.folder / 'robot.toml'}: base: missing, task velocity needs one")
    return spec.base
