"""Ring buffer of sent setpoints, interpolated at the time when a sample was taken."""

import numpy as np

from deploy.masks import all_true
from deploy.stage import Stage
from deploy.state import Setpoint
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec

HISTORY_S = 0.2
"""s of setpoints kept; an older sample is not used."""


class SetpointHistory(Stage):
    """Setpoints of the last `HISTORY_S` of B robots.

    Attributes:
        ring: (B, depth, 2n) angles (rad) and speeds (rad/s); tick k is at place k modulo depth.
        depth: ticks.
    """

    carried = ("ring",)

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        self._dt, self._n, self.depth = spec.dt, spec.n, round(HISTORY_S / spec.dt)
        self.ring = np.zeros((robots, self.depth, 2 * spec.n))
        self._first_row, self._newest = np.arange(robots) * self.depth, 0

    @property
    def q(self) -> Floats:
        """(B, n) rad, the newest setpoint."""
        return self.ring[:, self._newest, : self._n]

    def append(self, tick: int, sent: Setpoint) -> None:
        """Store the setpoint that the drives should have reached at `tick`."""
        self._newest = tick % self.depth
        row = self.ring[:, self._newest]
        row[:, : self._n], row[:, self._n :] = sent.q, sent.qd

    def fill(self, ids: Bools, sent: Setpoint) -> None:
        """Overwrite the whole history of robots `ids` (B,) by one setpoint."""
        self.ring[ids] = np.concatenate((sent.q, sent.qd), axis=1)[ids][:, None]

    def shift(self, q: Floats, qd: Floats, tick: int) -> None:
        """Add a motion at speeds qd (B, n) rad/s that is at q (B, n) rad at the present `tick`."""
        places = np.arange(self.depth)
        age = (tick - places) % self.depth * self._dt
        self.ring[:, :, : self._n] += q[:, None] - qd[:, None] * age[:, None]
        self.ring[:, :, self._n :] += qd[:, None]

    def covers(self, t: Floats, now: float) -> Bools:
        """Return (B,) robots whose t (B,) s is inside the history and at most one period after `now`."""
        covered: Bools = (t <= now + self._dt) & (t > now - (self.depth - 1) * self._dt)
        return covered

    def at(self, t: Floats, valid: Bools, tick: int) -> tuple[Floats, Floats]:
        """Return setpoints and speeds (B, n) rad, rad/s at t (B,) s: of the nearest tick, plus speed times the rest.

        Where t is not `valid` (B,) the result is of time 0; no setpoint after the present `tick` is known.
        """
        ticks = (t if all_true(valid) else np.where(valid, t, 0.0)) / self._dt
        whole = np.minimum(np.rint(ticks), tick)
        row = self._first_row + whole.astype(np.int64) % self.depth
        sent = self.ring.reshape(-1, 2 * self._n).take(row, axis=0)
        q, qd = sent[:, : self._n], sent[:, self._n :]
        return q + qd * ((ticks - whole) * self._dt)[:, None], qd
