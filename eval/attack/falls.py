"""Falls of robots with a floating base: any policy can let one fall.

An attack counts what a robot does until it falls or its drives end, and then only how the fall is noticed: without the
torque of its drives such a robot falls, whatever the runtime does.
"""

import numpy as np

from deploy.truth import Truth
from eval.judge.falls import FallCriterion
from robots.arrays import Bools
from robots.spec import RobotSpec

OF_FALLS = ("fallen", "powered_fallen")
"""Monitors of how a fall is noticed, which go on after it."""


class Falls:
    """Robots that have fallen since the beginning of a trial.

    Attributes:
        fallen: (B,) the base tilted too far or was too low, by ground truth, or the drives lost their power.
    """

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Begin with all robots on their feet, or on their mount."""
        self._criterion = FallCriterion(spec) if spec.base else None
        self.fallen, self._before = np.zeros((2, robots), dtype=bool)

    def step(self, truth: Truth, powered: Bools) -> Bools:
        """Return (B,) the robots that fell in the tick that has ended, in which drives were `powered` (B,) or not."""
        if truth.base is None or self._criterion is None:
            return np.zeros_like(self.fallen)
        new = (self._criterion.measure(truth.base).fallen | (self._before & ~powered)) & ~self.fallen
        self.fallen |= new
        self._before = powered
        return new
