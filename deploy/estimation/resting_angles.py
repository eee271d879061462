"""Mean of the estimated angles of joints at rest, where a robot is armed.

One estimate is off by the noise of an encoder, up to 2 mrad. Repeated attempts to arm would select an estimate whose
noise lets a robot pass a check that it does not pass on average.
"""

import numpy as np

from deploy.estimation.sample_count import sample_count
from deploy.stage import Stage
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec

MEAN_S = 0.25
"""s, time constant of the mean; until so much time has passed, all estimates have the same weight."""
DIFFERENCE_STD = 4.0
"""Difference of an estimate from the mean above which a joint creeps, in a slipping brake or in a hand: in standard
deviations of one encoder sample. With encoders twice as noisy as their data sheet says: five of an estimate.
"""


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
        self._difference = DIFFERENCE_STD * np.sqrt(spec.sensors["encoder"].variance)

    def step(self, q: Floats, resting: Bools) -> None:
        """Add estimates q (B, n) rad of robots that rest; elsewhere the mean restarts at q."""
        np.copyto(self.ticks, np.where(resting, np.minimum(self.ticks + 1, self._most), 0))
        mean = self.q + (q - self.q) / np.maximum(self.ticks, 1)[:, None]
        np.copyto(self.q, np.where(self.ticks[:, None] <= 1, q, mean))

    def creeping(self, q: Floats) -> Bools:
        """(B, n) joints whose estimate q (B, n) rad is further from their mean than noise."""
        return np.asarray(~(np.abs(q - self.q) <= self._difference))
