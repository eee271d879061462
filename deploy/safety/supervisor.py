"""State machine of each robot, from disarmed to latched: the categories of its stops and their reasons.

    DISARMED ─arm─▶ ARMING ──▶ RUNNING ──▶ STOPPING ─category 2─▶ HOLDING ──▶ RUNNING
        ▲                                     │
        └────────disarm─────── LATCHED ◀──category 1

Category 2 (IEC 60204-1): a controlled stop, power kept; the robot goes on by itself when the cause is gone.
Category 1: a controlled stop, then power is cut, once drives have taken over; only an operator's `arm` clears it.
Category 0: power is cut at once, every mode with power leads to LATCHED. If several apply, the lowest number wins.
Nothing here depends on the policy.
"""

import numpy as np

from deploy.masks import all_true, any_true
from deploy.reasons import AT_ONCE, LATCHING, Reason
from deploy.stage import Stage
from deploy.state import Mode
from robots.arrays import Bools, Ints

_DISARMED, _ARMING, _RUNNING, _STOPPING, _HOLDING, _LATCHED = (np.int8(mode) for mode in Mode)
_AT_ONCE, _LATCHING = np.int64(AT_ONCE), np.int64(LATCHING)
"""Numbers of numpy, which are five times as fast as an enumeration's."""
_POWERED = np.array([mode not in (Mode.DISARMED, Mode.LATCHED) for mode in Mode])
"""True for modes with drives on."""


class Supervisor(Stage):
    """Modes of B robots.

    Attributes:
        mode: (B,) of `Mode`. reason: (B,) bit sets of `Reason` since the last stop began.
        since: (B,) ticks in this mode.
    """

    carried = ("mode", "reason", "since")

    def __init__(self, robots: int, dt: float, *, arming_s: float = 0.1, hold_s: float = 0.25) -> None:
        """Start with all robots disarmed.

        Args:
            robots: B.
            dt: s, control period.
            arming_s: s, powered at rest before running.
            hold_s: s, at rest and without a reason before running again.
        """
        self.mode = np.full(robots, _DISARMED, dtype=np.int8)
        self.reason = np.zeros(robots, dtype=np.int64)
        self.since = np.zeros(robots, dtype=np.int64)
        self._arming, self._hold = round(arming_s / dt), round(hold_s / dt)

    @property
    def powered(self) -> Bools:
        """(B,) whether drives are on."""
        return _POWERED.take(self.mode)

    @property
    def running(self) -> Bools:
        """(B,) whether the policy is followed."""
        return np.equal(self.mode, _RUNNING)

    @property
    def stopping(self) -> Bools:
        """(B,) whether the smoother stops or rests instead of following the policy."""
        return ~self.running

    def arm(self, ids: Bools) -> None:
        """Power robots where `ids` holds and drives are off; they run after the arming time."""
        off = ids & ~self.powered
        self._enter(off, _ARMING)
        self.reason[off] = 0

    def disarm(self, ids: Bools) -> None:
        """Cut power at once: only for robots at rest, or as the last resort."""
        self._enter(ids, _DISARMED)

    def latch(self, ids: Bools, reason: Reason) -> None:
        """Cut power at once (category 0) where `ids` (B,) holds, until an operator arms again."""
        self._enter(ids, _LATCHED)
        self.reason[ids] |= np.int64(reason)

    def step(self, reason: Ints, at_rest: Bools, stopped: Bools) -> Bools:
        """Advance every robot; return (B,) whether its setpoint may be sent (others take the planned stop).

        Args:
            reason: (B,) bit sets against the setpoint, 0 where it is accepted.
            at_rest: (B,) whether the last sent setpoint is at rest.
            stopped: (B,) whether, at rest, power may be cut.
        """
        self.since += 1
        running = self.running
        refused: Bools = reason != 0
        if not all_true(running) or any_true(refused):
            self._change_modes(reason, refused, at_rest, stopped)
        return ~(running & refused)

    def _change_modes(self, reason: Ints, refused: Bools, at_rest: Bools, stopped: Bools) -> None:
        """Take every transition but staying in RUNNING, one a tick; a cut of power replaces any other."""
        running = self.running
        latches = (self.reason & _LATCHING) != 0
        stopping, holding, arming = (self.mode == m for m in (_STOPPING, _HOLDING, _ARMING))
        self.reason |= np.where(self.powered & ~(running & ~refused), reason, 0)
        self.since[holding & refused] = 0
        self._enter(arming & refused, _STOPPING)
        self._enter(arming & ~refused & (self.since >= self._arming), _RUNNING)
        self._enter(running & refused, _STOPPING)
        self._enter(stopping & stopped & latches, _LATCHED)
        self._enter(stopping & at_rest & ~latches, _HOLDING)
        self._enter(holding & stopped & latches, _LATCHED)
        self._enter(holding & ~latches & ~refused & (self.since >= self._hold), _RUNNING)
        self._enter(self.powered & ((reason & _AT_ONCE) != 0), _LATCHED)

    def _enter(self, ids: Bools, mode: np.int8) -> None:
        if not any_true(ids):
            return
        self.mode[ids] = mode
        self.since[ids] = 0
        if mode == _RUNNING:
            self.reason[ids] = 0
