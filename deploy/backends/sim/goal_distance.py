"""Simulated distance sensor: distance from a site of the robot to the goal, without reading while a body is between."""

import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim.model.allowed_contacts import GOAL_RADIUS_M
from deploy.backends.sim.model.attachments import Beam
from deploy.masks import all_true
from deploy.stage import Stage
from robots.arrays import Bools, Floats

NEAR_M = GOAL_RADIUS_M + 0.005
"""m before the goal at which a surface counts as that of the goal: its sphere where it can be touched, and rounding."""


class GoalDistance(Stage):
    """Distances of B robots, measured along a beam that is turned to the goal in every control tick.

    The direction is that of the tick before: at 2 m/s and 0.3 m from the goal, 2° off.

    Attributes:
        value: (B, 1) m; NaN without goal, and where a link or the scene is in between.
        position: (B, 3) m, the sensor in the world. orientation: (B, 3, 3) of its link in the world.
    """

    carried = ("value", "position", "orientation")

    def __init__(self, batch: Batch, beam: Beam) -> None:
        robots = batch.nsim
        self.value, self.position = np.full((robots, 1), np.nan), np.zeros((robots, 3))
        self.orientation = np.zeros((robots, 3, 3))
        self._turn = batch.expand("site_quat")[:, beam.site]
        self._site, self._body = batch.bind("site_xpos")[:, beam.site], batch.bind("xmat")[:, beam.body]
        self._surface = batch.bind("sensordata")[:, beam.place]

    def reset(self, ids: Bools, goal: Floats) -> None:
        """Measure robots where `ids` (B,) holds, which were moved, as if nothing were in between; goal (B, 3) m."""
        self._copy_pose(ids)
        self.value[ids, 0] = np.linalg.norm(goal - self.position, axis=1)[ids]

    def aim(self, goal: Floats) -> None:
        """Turn the beams to the goals (B, 3) m, before the physics of a tick."""
        local = np.vecmat(goal - self.position, self.orientation)
        length = np.linalg.norm(local, axis=1, keepdims=True)
        local = np.where(length > 0.0, local / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])
        # The shortest rotation of z to x, y, z is (1 + z, −y, x, 0), normalized; about x where it is half a turn.
        turn = np.stack((1.0 + local[:, 2], -local[:, 1], local[:, 0], np.zeros(len(local))), axis=1)
        size = np.linalg.norm(turn, axis=1, keepdims=True)
        self._turn[:] = np.where(size > 1e-6, turn / np.maximum(size, 1e-6), [0.0, 1.0, 0.0, 0.0])

    def measure(self, goal: Floats) -> None:
        """Read the distances of the goals (B, 3) m, after the physics of a tick."""
        self._copy_pose(np.ones(len(goal), dtype=bool))
        distance = np.linalg.norm(goal - self.position, axis=1)
        blocked = (self._surface >= 0.0) & (self._surface < distance - NEAR_M)  # −1: no surface
        self.value[:, 0] = np.where(blocked, np.nan, distance)

    def _copy_pose(self, ids: Bools) -> None:
        rows = slice(None) if all_true(ids) else ids
        self.position[rows] = self._site[rows]
        self.orientation[rows] = self._body[rows].reshape(-1, 3, 3)
