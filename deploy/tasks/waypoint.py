"""Waypoint: walk to a point that is given by its direction and distance, one point after another.

No sensor measures where the robot is in the world. Its way is dead reckoned: the estimated velocity of its base, turned
by the estimated heading, is added up from when a point is given. Errors of velocity and heading add up as well, until
the next point begins at zero; robots/quadruped/README.md has figures. The judge measures by ground truth.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from deploy.masks import any_true
from deploy.sources.floating_base import BASE
from deploy.sources.maximum import UNITY, Maximum
from deploy.sources.source import ObservationSource
from deploy.state import Sample
from deploy.tasks.success import SuccessCriterion
from deploy.tasks.task import Task
from deploy.tasks.walking import WalkingTask, yaw
from deploy.truth import Truth
from robots.arrays import Floats
from robots.capabilities import required
from robots.models.nominal_model import imu_in_base, load_pinocchio
from robots.rotations import matrix, matvec, skew
from robots.spec import RobotSpec

if TYPE_CHECKING:
    from deploy.runtime import Runtime

TOLERANCE_M, NEAR_M = 0.25, 0.5
"""m, distance at which a point counts as reached, and of the nearest points."""
PACE = 0.5
"""Distance of the farthest points, as share of what the robot walks at its highest speed until the period ends."""
_RECKONED = "operator, then dead reckoning by velocity and heading of the base"
_DRIFT = (
    "its error grows with the way since the point was given, and wherever feet slip or fly: train with that error, and"
    " give points that are near"
)


def farthest(spec: RobotSpec) -> float:
    """Return m, the distance of the farthest points."""
    base = Waypoint.base_of(spec)
    return PACE * base.command_max[0] * base.command_s


def turned(vectors: Floats, angle: Floats) -> Floats:
    """Return horizontal vectors (B, 2) turned to the left by angles (B,) rad."""
    (x, y), cos, sin = vectors.T, np.cos(angle), np.sin(angle)
    return np.stack((cos * x - sin * y, sin * x + cos * y), axis=1)


def _left_to_walk(runtime: "Runtime") -> Floats:
    """(B, 2) m forwards and to the left, from the robot to its point."""
    task = runtime.task
    if not isinstance(task, Waypoint):
        raise RuntimeError(f"task {task.name} has no waypoint")
    return turned(task.goal - task.moved, task.heading - yaw(runtime.base.quat_wxyz))


def _direction(runtime: "Runtime") -> Floats:
    forwards, left = _left_to_walk(runtime).T
    angle = np.arctan2(left, forwards)
    return np.stack((np.sin(angle), np.cos(angle)), axis=1)


class Waypoint(WalkingTask):
    """Points in m forwards and to the left of where the robot stood and headed when the point was given.

    Directions are uniform in the circle and distances between `NEAR_M` and the farthest; `achieved` is where the robot
    has come to, in the same frame.

    Attributes:
        moved: (B, 2) m, reckoned since the present point was given. heading: (B,) rad, estimated then.
        begun: (B,) number of the point that they are counted for.
        true_start: (B, 3) m, m, rad: true place and heading when a point was given. true_begun: (B,) its number.
    """

    name = "waypoint"
    size = 2
    sources: ClassVar[Mapping[str, ObservationSource]] = {
        "waypoint_direction": ObservationSource(
            frame="base",
            unit="1",
            size=2,
            sensing="proprioceptive",
            maximum=UNITY,
            read=_direction,
            meaning=f"sine and cosine of the angle to the left from the heading to the point: {_RECKONED}",
            sensors=("gyro", "accelerometer"),
            needs=BASE,
            doubt=_DRIFT,
        ),
        "waypoint_distance": ObservationSource(
            frame="base",
            unit="m",
            sensing="proprioceptive",
            maximum=Maximum("distance of the farthest points", lambda scale: farthest(scale.spec)),
            read=lambda runtime: np.hypot(*_left_to_walk(runtime).T)[:, None],
            meaning=f"distance of the point: {_RECKONED}",
            sensors=("gyro", "accelerometer"),
            needs=BASE,
            doubt=_DRIFT,
        ),
    }
    command: ClassVar[tuple[str, ...]] = ("waypoint_direction", "waypoint_distance")
    observation: ClassVar[tuple[str, ...]] = (
        *("base_angular_velocity", "projected_gravity", *command),
        *("joint_position", "joint_velocity", "last_action"),
    )
    carried: ClassVar[tuple[str, ...]] = (
        *(*Task.carried, "moved", "heading", "begun"),
        *("true_start", "true_begun"),
    )

    def __init__(self, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence]) -> None:
        robots, self._far = len(seeds), farthest(spec)
        # The IMU moves with v + ω × r; this is r ×, which gives the root body's velocity, as the truth's, from it.
        self._to_root = skew(imu_in_base(spec, load_pinocchio(spec)[0])).T
        self.moved, self.heading, self.true_start = (
            np.zeros((robots, 2)),
            np.zeros(robots),
            np.zeros((robots, 3)),
        )
        self.begun, self.true_begun = np.zeros((2, robots), dtype=np.int64)
        super().__init__(spec, seeds)

    @classmethod
    def misfit(cls, spec: RobotSpec) -> str:
        """Describe a robot that does not walk as far as the nearest points; empty if it does."""
        far, base = farthest(spec), cls.base_of(spec)
        if far > NEAR_M:
            return ""
        return (
            f"needs {NEAR_M / PACE:g} m forwards in each period; base.command_max {base.command_max[0]:g} m/s for"
            f" base.command_s {base.command_s:g} s are less"
        )

    @classmethod
    def success_criterion(cls, spec: RobotSpec) -> SuccessCriterion:
        """Within `TOLERANCE_M` when the period ends."""
        return SuccessCriterion(size=2, period_s=cls.base_of(spec).command_s, tolerance=TOLERANCE_M)

    def true_achieved(self, truth: Truth) -> Floats:
        """(B, 2) m, true place in the frame of `goal`; to be read at least once while a point is given.

        In the tick in which a point's time ends it is still that point's.
        """
        base = required(truth.base)
        pose = np.concatenate((base.position[:, :2], yaw(base.quat_wxyz)[:, None]), axis=1)
        if any_true(begins := self.number != self.true_begun + self.ended):
            self.true_start[begins], self.true_begun[begins] = pose[begins], self.number[begins]
        return turned(pose[:, :2] - self.true_start[:, :2], -self.true_start[:, 2])

    def sample_goal(self, rng: np.random.Generator) -> Floats:
        """(2,) m."""
        direction, distance = rng.uniform(-np.pi, np.pi), rng.uniform(NEAR_M, max(NEAR_M, self._far))
        return distance * np.array([np.cos(direction), np.sin(direction)])

    def observe(self, runtime: "Runtime", sample: Sample, due: bool) -> None:
        """Add the estimated motion of this tick; begin at zero where a new point is given."""
        del sample, due
        base = runtime.base
        velocity = matvec(
            matrix(base.quat_wxyz), base.velocity_in_base + base.angular_velocity @ self._to_root
        )
        self.moved += turned(velocity[:, :2] * self.spec.dt, -self.heading)
        self.achieved[:] = self.moved
        if any_true(begins := self.number != self.begun):
            self.heading[begins], self.moved[begins] = yaw(base.quat_wxyz[begins]), 0.0
            self.begun[begins] = self.number[begins]
            self.achieved[begins & ~self.ended] = 0.0
