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
"""s, longest time whose mean is taken."""
DIFFERENCE_STD = 12.0
"""Standard deviations of an estimate, by which it may differ from the mean of a joint at rest: six where encoders are
twice as noisy as their data sheet says. A joint that creeps, in a brake that slips or in a hand, differs by more."""


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

    def step(self, q: Floats, q_var: Floats, resting: Bools) -> None:
        """Add estimates q (B, n) rad, of variance q_var (B, n) rad², of robots that rest; other means begin at q."""
        off = np.abs(q - self.q) > DIFFERENCE_STD * np.sqrt(q_var)
        goes_on = resting & ((self.ticks == 0) | ~off.any(axis=1))
        np.copyto(self.ticks, np.where(goes_on, np.minimum(self.ticks + 1, self._most), 0))
        mean = self.q + (q - self.q) / np.maximum(self.ticks, 1)[:, None]
        np.copyto(self.q, np.where(self.ticks[:, None] <= 1, q, mean))
