"""Tasks of robots that walk: one command after another, each as long as the robot's `base.command_s`."""

from typing import ClassVar

import numpy as np

from deploy.sources.floating_base import BASE
from deploy.tasks.task import Task
from robots.arrays import Bools, Floats
from robots.capabilities import Capability
from robots.errors import RobotError
from robots.spec import RobotSpec
from robots.tables import Base


class WalkingTask(Task):
    """Commands to a robot with a floating base."""

    needs: ClassVar[frozenset[Capability]] = BASE

    @classmethod
    def limit_goal_period(cls, spec: RobotSpec, period_s: float) -> RobotSpec:
        """Return the robot with commands of at most `period_s` s."""
        base = cls.base_of(spec)
        shorter = base.model_copy(update={"command_s": min(base.command_s, period_s)})
        return spec.model_copy(update={"base": shorter})

    @classmethod
    def base_of(cls, spec: RobotSpec) -> Base:
        """Return the robot's floating base; RobotError if it has none."""
        if spec.base is None:
            raise RobotError(f"{spec.folder / 'robot.toml'}: base: missing, task {cls.name} needs one")
        return spec.base

    def arm(self, ids: Bools) -> None:
        """Begin a new command: a robot without power cannot follow one."""
        self.reset(ids)


def yaw(quat_wxyz: Floats) -> Floats:
    """(B,) rad, heading of the x axis of bases (B, 4) in the world."""
    w, x, y, z = quat_wxyz.T
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
