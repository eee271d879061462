"""Late ticks: what the joints do that nobody led for some slots.

Drives keep the last command, so that joints come to rest there while the setpoint's speed stays what it was. When the
trajectory goes on, they catch up. Both is motion that the filter's process noise does not cover: without more variance
its gate would refuse the samples.

    p00 += (qd T)²            qd  rad/s  setpoint's speed before the slots      T  s  skipped time
    p11 += qd² dt/CATCH_UP_S  dt  s      control period, for each tick until CATCH_UP_S after the late one
"""

from typing import ClassVar

import numpy as np

from deploy.estimation.joint_filter import JointFilter
from deploy.masks import any_true
from deploy.stage import Stage
from robots.arrays import Floats, Ints
from robots.spec import RobotSpec

CATCH_UP_S = 0.1
"""s in which drives catch up with a trajectory that goes on at full speed."""


class LateTicks(Stage):
    """Robots whose drives catch up after a late tick.

    Attributes:
        ticks: (B,) left of catching up. qd: (B, n) rad/s, speed of the setpoint before the late tick.
    """

    carried: ClassVar[tuple[str, ...]] = ("ticks", "qd")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        self._dt, self._catch_up = spec.dt, round(CATCH_UP_S / spec.dt)
        self.ticks, self.qd = np.zeros(robots, dtype=np.int64), np.zeros((robots, spec.n))

    def skip(self, slots: Ints, qd: Floats, joints: JointFilter) -> None:
        """Begin where the coming tick is `slots` (B,) late; `qd` (B, n) rad/s is the speed of the last setpoint."""
        late = slots > 0
        self.ticks[late], self.qd[late] = self._catch_up, qd[late]
        skipped = self.qd * (slots * self._dt)[:, None]
        joints.widen(skipped * skipped, np.zeros(skipped.shape))

    def step(self, joints: JointFilter) -> None:
        """Widen the variances of robots that catch up, by one tick."""
        if not any_true(self.ticks):
            return
        share = np.where(self.ticks > 0, self._dt / CATCH_UP_S, 0.0)
        joints.widen(np.zeros(self.qd.shape), self.qd**2 * share[:, None])
        np.maximum(self.ticks - 1, 0, out=self.ticks)
