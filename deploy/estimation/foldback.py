"""Foldback: less current and less speed for motors whose windings approach their temperature limit."""

import numpy as np

from deploy.stage import Stage
from robots.arrays import Floats
from robots.spec import RobotSpec

STEPS = 20
"""Steps from no foldback to full foldback; each step costs a new trajectory."""
HYSTERESIS = 1.5
"""Steps that a winding must have cooled before its foldback is reduced; without them it would toggle at every edge."""
RANGE_MIN_K = 0.1
"""K, least range from no foldback to full foldback, however large the margin is."""


class Foldback(Stage):
    """Limits of current and speed of B × n motors.

    Attributes:
        level: (B, n) 0 below the soft limit, rising linearly to 1 where the robot stops: winding plus margin at the
            hard limit.
        current_share: (B, n) share of its current that a running motor may draw, from 1 down to `margins.fold_min`.
        speed_share: (B,) share of speed and acceleration that the robot may be sent, by its hottest motor: from 1 down
            to `margins.pace_min`, so that the motion needs no more than the current that is left.
    """

    carried = ("level", "current_share", "speed_share")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        shape = robots, spec.n
        self.level, self.current_share, self.speed_share = np.zeros(shape), np.ones(shape), np.ones(robots)
        self._soft, self._hard = spec.motor_array("winding_soft_c"), spec.motor_array("winding_max_c")
        self._current_min, self._speed_min = spec.margins.fold_min, spec.margins.pace_min

    def step(self, winding: Floats, margin: Floats) -> None:
        """Raise the level by whole steps at once, reduce it with hysteresis.

        A winding (B, n) °C may be hotter by `margin` (B, n) K; NaN, unknown, counts as too hot.
        """
        share = (winding - self._soft) / np.maximum(self._hard - margin - self._soft, RANGE_MIN_K)
        stepped = np.floor(np.clip(share, 0.0, 1.0) * STEPS) / STEPS
        stepped[np.isnan(share)] = 1.0
        cooled = share <= self.level - HYSTERESIS / STEPS
        np.copyto(self.level, stepped, where=(stepped > self.level) | cooled)
        np.subtract(1.0, (1.0 - self._current_min) * self.level, out=self.current_share)
        np.subtract(1.0, (1.0 - self._speed_min) * self.level.max(axis=1), out=self.speed_share)
