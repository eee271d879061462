"""Joint targets from the policy's action, by the scale, offset and clip of the contract."""

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract_action import ActionSpec
from deploy.stage import Stage
from deploy.state import Target
from robots.arrays import Bools, Floats


class Action(Stage):
    """Joint targets of B robots: set by an action, or incremented by it within a leash around the setpoint.

    Attributes:
        q: (B, n) rad, target. last: (B, A) last finite action, clipped. finite: (B,) the last action was finite.
    """

    carried = ("q", "last", "finite")
    q: Floats
    last: Floats

    def __init__(self, spec: ActionSpec, robots: int) -> None:
        """Allocate for B robots."""
        self.scale = np.tile(spec.scale, (robots, 1))
        self.low, self.high = spec.bounds
        self._from = None if spec.offset is None else np.tile(spec.offset, (robots, 1))
        self.leash = spec.leash_rad or np.inf
        self.q = np.zeros((robots, spec.size))
        self.last = np.zeros((robots, spec.size))
        self.finite = np.ones(robots, dtype=bool)

    def reset(self, ids: Bools, q: Floats) -> None:
        """Set the targets of robots where `ids` (B,) holds to `q` (B, n) rad; their last action is 0."""
        self.q[ids], self.last[ids], self.finite[ids] = q[ids], 0.0, True

    def hold(self, ids: Bools, q: Floats) -> None:
        """Hold the targets of robots where `ids` (B,) holds at `q` (B, n) rad, so that increments do not wind up."""
        np.copyto(self.q, q, where=ids[:, None])

    def step(self, action: Floats | NDArray[np.float32], q_setpoint: Floats) -> Target:
        """Return the new target.

        Args:
            action: (B, A) raw action; a row that is not finite changes only `finite`.
            q_setpoint: (B, n) rad, present setpoint.
        """
        np.isfinite(action).all(axis=1, out=self.finite)
        use = self.finite[:, None]
        np.copyto(self.last, np.minimum(np.maximum(action, self.low), self.high), where=use)
        moved = (self.q if self._from is None else self._from) + self.scale * self.last
        leashed = np.minimum(np.maximum(moved, q_setpoint - self.leash), q_setpoint + self.leash)
        np.copyto(self.q, leashed, where=use)
        return self.target

    @property
    def target(self) -> Target:
        """Present target."""
        return Target(q=self.q, finite=self.finite)
