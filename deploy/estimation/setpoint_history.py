"""Ring buffer of sent setpoints, interpolated at the time when a sample was taken."""

import numpy as np

from deploy.stage import Stage
from deploy.state import Packet, Setpoint
from robots.arrays import Bools, Floats
from robots.kernel import BOOL, FLOAT, array, kernel
from robots.spec import RobotSpec

HISTORY_S = 0.2
"""s of setpoints kept, or two ticks of a slow robot; an older sample is not used."""


class SetpointHistory(Stage):
    """Setpoints of the last `HISTORY_S` of B robots.

    Attributes:
        ring: (B, depth, 2n) angles (rad) and speeds (rad/s); tick k is at place k modulo depth.
        depth: ticks.
    """

    carried = ("ring",)

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        self._dt, self._n, self.depth = spec.dt, spec.n, max(2, round(HISTORY_S / spec.dt))
        self.ring, self._newest = np.zeros((robots, self.depth, 2 * spec.n)), 0

    @property
    def q(self) -> Floats:
        """(B, n) rad, the newest setpoint."""
        return self.ring[:, self._newest, : self._n]

    def append(self, tick: int, sent: Setpoint) -> None:
        """Store the setpoint that the drives should have reached at `tick`."""
        self._newest = tick % self.depth
        np.concatenate((sent.q, sent.qd), axis=1, out=self.ring[:, self._newest])

    def fill(self, ids: Bools, sent: Setpoint) -> None:
        """Overwrite the whole history of robots `ids` (B,) by one setpoint."""
        self.ring[ids] = np.concatenate((sent.q, sent.qd), axis=1)[ids][:, None]

    def shift(self, q: Floats, qd: Floats, tick: int) -> None:
        """Add a motion at speeds qd (B, n) rad/s that is at q (B, n) rad at the present `tick`."""
        places = np.arange(self.depth)
        age = (tick - places) % self.depth * self._dt
        self.ring[:, :, : self._n] += q[:, None] - qd[:, None] * age[:, None]
        self.ring[:, :, self._n :] += qd[:, None]

    def at(self, packet: Packet, now: float) -> tuple[Bools, Floats, Floats]:
        """Return (B,) packets that are usable, and setpoints and speeds (B, n) rad, rad/s at the times of these.

        Usable is a fresh packet whose time is inside the history, and at most one period after `now` s, the time of the
        newest setpoint. At other packets the result is of time 0.
        """
        usable, found = np.empty(len(self.ring), dtype=bool), np.empty((len(self.ring), 2 * self._n))
        _interpolate(self.ring, packet.t, packet.fresh, now, self._dt, usable, found)
        return usable, found[:, : self._n], found[:, self._n :]


@kernel(
    *(array(FLOAT, 3), array(FLOAT, 1), array(BOOL, 1), FLOAT, FLOAT),
    *(array(BOOL, 1, written=True), array(FLOAT, 2, written=True)),
)
def _interpolate(
    ring: Floats, t: Floats, fresh: Bools, now: float, dt: float, usable: Bools, found: Floats
) -> None:
    """Take the setpoint of the nearest tick, plus its speed times the rest; none after the newest one is known."""
    robots, depth, width = ring.shape
    n = width // 2
    for robot in range(robots):
        usable[robot] = fresh[robot] and now - (depth - 1) * dt < t[robot] <= now + dt
        ticks = t[robot] / dt if usable[robot] else 0.0
        whole = min(np.rint(ticks), np.rint(now / dt))
        sent = ring[robot, int(whole) % depth]
        for joint in range(n):
            found[robot, joint] = sent[joint] + sent[n + joint] * ((ticks - whole) * dt)
            found[robot, n + joint] = sent[n + joint]
