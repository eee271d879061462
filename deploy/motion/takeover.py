"""Position drives of a stop that take over from drives that hold no angle, and become stiff."""

from typing import ClassVar

import numpy as np

from deploy.masks import any_true
from deploy.stage import Stage
from deploy.state import DriveMode
from robots.arrays import Bools, Ints

TAKEOVER_S = 0.3
"""s in which the drives of a stop reach their stiffness: the estimate that a stop begins at has noise, and lags behind
an arm that is pushed. At full stiffness some milliradians are all the torque that a motor has."""
TAKEOVER_SHARE = 0.01
"""Share of its stiffness that a drive begins with."""
DAMPING_POWER = 0.25
"""Power of that share, the share of its damping: with 0.5 the damping ratio would stay. With less, a drive removes the
difference in speed first, then pulls the joint to its angle."""


class Takeover(Stage):
    """Drives of a stop, which take over from drives of the policy that hold no angle, and become stiff.

    Attributes:
        held: (B,) ticks for which drives have followed angles, up to those of `TAKEOVER_S`.
    """

    carried: ClassVar[tuple[str, ...]] = ("held",)

    def __init__(self, policy: DriveMode, stop: DriveMode, dt: float) -> None:
        self._stop, self._free, self._ticks = stop, policy.kp == 0.0, round(TAKEOVER_S / dt)
        self.held = np.full(len(stop.mode), self._ticks)

    @property
    def drive(self) -> DriveMode:
        """Drives of a robot that stops now."""
        return self._after(self.held)

    @property
    def first_drive(self) -> DriveMode:
        """Drives of a robot whose stop begins."""
        return self._after(np.zeros_like(self.held))

    def _after(self, held: Ints) -> DriveMode:
        """Return position drives that have been so for `held` (B,) ticks."""
        if not any_true(held < self._ticks):
            return self._stop
        share = np.where(self._free, TAKEOVER_SHARE ** (1.0 - held / self._ticks)[:, None], 1.0)
        return self._stop._replace(kp=self._stop.kp * share, kd=self._stop.kd * share**DAMPING_POWER)

    def end(self, ids: Bools) -> None:
        """Drives of robots in `ids` (B,) have their whole stiffness."""
        self.held[ids] = self._ticks

    def commit(self, followed: Bools) -> None:
        """Count a tick in which robots `followed` (B,) the policy, and others an angle."""
        self.held[:] = np.where(followed, 0, np.minimum(self.held + 1, self._ticks))
