"""Falls of robots with a floating base: any policy can let one fall.

An attack counts what a robot does until it falls, and then only how the fall is noticed.
"""

import numpy as np

from deploy.truth import Truth
from eval.judge.tick_window import true_tilt
from robots.arrays import Bools
from robots.spec import RobotSpec

OF_FALLS = ("fallen", "powered_fallen")
"""Monitors of how a fall is noticed, which go on after it."""


class Falls:
    """Robots that have fallen since the beginning of a trial.

    Attributes:
        fallen: (B,) the true tilt of the base has passed its limit.
    """

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Begin with all robots on their feet, or on their mount."""
        self._tilt_max = spec.base.tilt_max_rad if spec.base else np.inf
        self.fallen = np.zeros(robots, dtype=bool)

    def step(self, truth: Truth) -> Bools:
        """Return (B,) the robots that fell in the tick that has ended."""
        if truth.base is None:
            return np.zeros_like(self.fallen)
        new = (true_tilt(truth.base) > self._tilt_max) & ~self.fallen
        self.fallen |= new
        return new
