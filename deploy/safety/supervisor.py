"""Who may move, who must stop, and why: one ordered state machine for each robot.

    DISARMED ─arm─▶ ARMING ──▶ RUNNING ──▶ STOPPING ─category 2─▶ HOLDING ──▶ RUNNING
        ▲                                     │
        └────────disarm─────── LATCHED ◀──category 1

Category 2 (IEC 60204-1): a controlled stop, power kept; it clears by itself when the cause is gone.
Category 1: a controlled stop, then power is cut; only an operator's `arm` clears it. The higher category wins.
Nothing here depends on the policy.
"""

import numpy as np

from deploy.masks import all_true, any_true
from deploy.stage import Stage
from deploy.state import Mode, Reason
from robots.arrays import Bools, Ints

CATEGORY_1 = (
    Reason.LOST
    | Reason.NOT_FINITE
    | Reason.HEAT
    | Reason.TRACKING
    | Reason.OUTSIDE
    | Reason.STUCK
    | Reason.DIVERGED
    | Reason.LOAD
    | Reason.FALLEN
    | Reason.OVERRUN
    | Reason.OPERATOR
)
"""Reasons after which the robot may not go on by itself; every other reason is category 2."""

_DISARMED, _ARMING, _RUNNING, _STOPPING, _HOLDING, _LATCHED = (np.int8(mode) for mode in Mode)
_LATCHING = np.int64(CATEGORY_1)
"""The same as numpy's own numbers: it is five times as fast with them as with an enumeration's."""
_POWERED = np.array([mode not in (Mode.DISARMED, Mode.LATCHED) for mode in Mode])
"""Whether drives are on, by mode."""

WORDS = {
    Reason.POSITION: "a joint would leave its working range",
    Reason.VELOCITY: "a joint would exceed its speed",
    Reason.TORQUE: "a joint would need more torque than it has",
    Reason.WORKSPACE: "the tool would leave its workspace",
    Reason.COLLISION: "links would come nearer than the collision margin",
    Reason.SINGULARITY: "the arm would come too near a singularity, or pass it",
    Reason.TOOL_SPEED: "the tool would be too fast",
    Reason.HEAT: "a motor is too hot, or nobody knows how hot it is",
    Reason.STALE: "samples are missing",
    Reason.LOST: "samples stay away",
    Reason.TRACKING: "a joint does not follow its setpoint",
    Reason.NOT_FINITE: "a number is not finite",
    Reason.OVERRUN: "too many ticks came late",
    Reason.OPERATOR: "stopped by the operator",
    Reason.OUTSIDE: "a joint is outside its working range",
    Reason.STUCK: "a sensor says the same, again and again",
    Reason.MOVING: "a joint moves while the drives are off",
    Reason.DIVERGED: "an estimate does not fit what is measured",
    Reason.LOAD: "a motor's current does not fit what its motion needs",
    Reason.FALLEN: "the robot leans too far: it falls, or has fallen",
}


def words(reason: int) -> str:
    """A bit set of reasons in words."""
    return "; ".join(WORDS[bit] for bit in Reason(reason)) or "no reason"


class Supervisor(Stage):
    """Modes of B robots."""

    carried = ("mode", "reason", "since")

    def __init__(self, robots: int, dt: float, *, arming_s: float = 0.1, hold_s: float = 0.25) -> None:
        """All robots disarmed.

        Args:
            robots: B.
            dt: s, control period.
            arming_s: s, powered at rest before running.
            hold_s: s, at rest and without a cause before running again.
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
        """(B,) whether the smoother brakes or rests instead of following the policy."""
        return ~self.running

    def arm(self, ids: Bools) -> None:
        """Power robots where `ids` holds and drives are off; they run after the arming time."""
        off = ids & ~self.powered
        self._enter(off, _ARMING)
        self.reason[off] = 0

    def disarm(self, ids: Bools) -> None:
        """Cut power at once: only for robots that rest, or when nothing else is left."""
        self._enter(ids, _DISARMED)

    def latch(self, ids: Bools, reason: Reason) -> None:
        """Category 0: cut power now, where `ids` (B,) holds, until an operator arms again."""
        self._enter(ids, _LATCHED)
        self.reason[ids] |= np.int64(reason)

    def step(self, reason: Ints, at_rest: Bools) -> Bools:
        """Advance every robot; return (B,) whose setpoint may be sent (others take the planned stop).

        Args:
            reason: (B,) why the setpoint is refused, 0 where it is not.
            at_rest: (B,) whether the last sent setpoint stands still.
        """
        self.since += 1
        running = self.running
        refused: Bools = reason != 0
        if not all_true(running) or any_true(refused):
            self._others(reason, refused, running, at_rest)
        return ~(running & refused)

    def _others(self, reason: Ints, refused: Bools, running: Bools, at_rest: Bools) -> None:
        """Every transition but staying in RUNNING; each robot takes at most one a tick."""
        latches = (self.reason & _LATCHING) != 0
        stopping, holding, arming = (self.mode == m for m in (_STOPPING, _HOLDING, _ARMING))
        self.reason |= np.where(self.powered & ~(running & ~refused), reason, 0)
        self.since[holding & refused] = 0
        self._enter(arming & refused, _STOPPING)
        self._enter(arming & ~refused & (self.since >= self._arming), _RUNNING)
        self._enter(running & refused, _STOPPING)
        self._enter(stopping & at_rest & latches, _LATCHED)
        self._enter(stopping & at_rest & ~latches, _HOLDING)
        self._enter(holding & latches, _LATCHED)
        self._enter(holding & ~latches & ~refused & (self.since >= self._hold), _RUNNING)

    def _enter(self, ids: Bools, mode: np.int8) -> None:
        if not any_true(ids):
            return
        self.mode[ids] = mode
        self.since[ids] = 0
        if mode == _RUNNING:
            self.reason[ids] = 0
