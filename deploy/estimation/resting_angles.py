"""Mean of the estimated angles of joints at rest, where a robot is armed.

One estimate is off by the noise of an encoder, up to 2 mrad. Who tries to arm again and again would choose the moment
at which that noise lets a robot pass a check that it does not pass on average.
"""

import numpy as np

from deploy.estimation.sample_count import sample_count
from deploy.stage import Stage
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec

MEAN_S = 0.5
"""s, longest time whose mean is taken: a joint that creeps is soon followed."""


class RestingAngles(Stage):
    """Mean angles of B × n joints over the time for which a robot has rested without power.

    Attributes:
        q: (B, n) rad. ticks: (B,) number of estimates in the mean, 0 where a robot does not rest.
    """

    carried = ("q", "ticks")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Allocate for robots that have not rested yet."""
        self.q, self.ticks = np.zeros((robots, spec.n)), np.zeros(robots, dtype=np.int64)
        self._most = sample_count(MEAN_S, spec.dt)

    def step(self, q: Floats, resting: Bools) -> None:
        """Add estimates q (B, n) rad of robots that rest; the mean of the others begins again at q."""
        np.copyto(self.ticks, np.where(resting, np.minimum(self.ticks + 1, self._most), 0))
        first = self.ticks[:, None] <= 1
        mean = self.q + (q - self.q) / np.maximum(self.ticks, 1)[:, None]
        np.copyto(self.q, np.where(first, q, mean))
