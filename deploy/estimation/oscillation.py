"""Oscillation of joints: turning points of the estimated speed, counted as for fatigue, in a window that forgets.

A policy that shakes a robot stays inside every limit of a setpoint, and wears gears and heats motors all the same.
Source: ASTM E1049-85 (2017), 5.2, peak counting, with a dead band against noise.
"""

import math

import numpy as np

from deploy.masks import any_true
from deploy.stage import Stage
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec

SWING = 0.1
"""Share of a joint's speed limit by which its speed must turn back to count."""
WINDOW_S = 2.0
"""Time constant of the count, s."""


class OscillationDetection(Stage):
    """Turning points of B × n joint speeds.

    Attributes:
        extreme: (B, n) rad/s, farthest speed since the last turning point. rising: (B, n) 1 or -1, direction since.
        count: (B, n) turning points, of which 1/e are left after `WINDOW_S`.
    """

    carried = ("extreme", "rising", "count")

    def __init__(self, spec: RobotSpec, robots: int, look_s: float) -> None:
        """Begin at rest; `step` is called every `look_s` s."""
        self.extreme, self.count = np.zeros((2, robots, spec.n))
        self.rising = np.ones((robots, spec.n))
        self._swing, self._kept = -SWING * spec.joint_array("qd_max"), math.exp(-look_s / WINDOW_S)
        hz = spec.margins.oscillation_hz
        self._count_max = math.inf if hz is None else 2.0 * hz * WINDOW_S

    def reset(self, ids: Bools) -> None:
        """Forget the turning points of robots where `ids` (B,) holds."""
        self.count[ids] = 0.0

    def step(self, qd: Floats) -> Bools:
        """Count turning points of speeds (B, n) rad/s; return (B, n) joints that have too many."""
        ahead = self.rising * (qd - self.extreme)
        turned = ahead < self._swing
        self.count *= self._kept
        self.count += turned
        np.copyto(self.extreme, qd, where=turned | (ahead > 0.0))
        if any_true(turned):
            self.rising[turned] *= -1.0
        return self.oscillating

    @property
    def oscillating(self) -> Bools:
        """(B, n) joints that have too many turning points."""
        return np.asarray(self.count > self._count_max)
