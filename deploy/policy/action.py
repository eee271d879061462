"""From the policy's numbers to joint targets, as the contract says."""

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract import ActionSpec
from deploy.stage import Stage
from deploy.state import Target
from robots.arrays import Bools, Floats


class Action(Stage):
    """Joint targets: where an action says, or moved by it, on a leash around the trajectory."""

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
        """Targets (B, n) of robots where `ids` holds start at `q`; their last action is none."""
        self.q[ids], self.last[ids], self.finite[ids] = q[ids], 0.0, True

    def hold(self, ids: Bools, q: Floats) -> None:
        """Targets (B, n) of robots where `ids` holds stay with the robot: what it may not follow piles up nowhere."""
        np.copyto(self.q, q, where=ids[:, None])

    def step(self, action: Floats | NDArray[np.float32], q_setpoint: Floats) -> Target:
        """The new target.

        Args:
            action: (B, A) what the policy said; a row that is not finite changes nothing but `finite`.
            q_setpoint: (B, n) rad, where the trajectory is.
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
        """The target as it stands."""
        return Target(q=self.q, finite=self.finite)
