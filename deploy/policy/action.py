"""Joint targets from the policy's action, by the mode, scale, offset and clip of the contract."""

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract_action import ActionSpec
from deploy.stage import Stage
from deploy.state import DriveMode, Target
from robots.arrays import Bools, Floats


class Action(Stage):
    """Joint targets of B robots: set by an action, or incremented by it within a leash around the setpoint.

    Attributes:
        value: (B, n) target in the unit of the mode: rad, rad/s or N·m.
        last: (B, A) last finite action, clipped. finite: (B,) the last action was finite.
    """

    carried = ("value", "last", "finite")
    value: Floats
    last: Floats

    def __init__(self, spec: ActionSpec, drive: DriveMode) -> None:
        """Allocate for the robots of `drive`, the mode in which drives follow the policy."""
        self._drive, robots = drive, len(drive.mode)
        self.scale = np.tile(spec.scale, (robots, 1))
        self.low, self.high = spec.bounds
        self._increments, self._offset = spec.leash_rad is not None, np.zeros((robots, spec.size))
        self._offset += spec.offset or 0.0
        self.leash = spec.leash_rad or np.inf
        self._change_max = None if spec.change_max is None else np.tile(spec.change_max, (robots, 1))
        self.value = np.zeros((robots, spec.size))
        self.last = np.zeros((robots, spec.size))
        self.finite = np.ones(robots, dtype=bool)

    def reset(self, ids: Bools, value: Floats) -> None:
        """Set the targets of robots where `ids` (B,) holds to `value` (B, n); their last action is 0."""
        self.value[ids], self.last[ids], self.finite[ids] = value[ids], 0.0, True

    def hold(self, ids: Bools, value: Floats) -> None:
        """Hold the targets of robots where `ids` (B,) holds at `value` (B, n), so that increments do not wind up."""
        np.copyto(self.value, value, where=ids[:, None])

    @np.errstate(invalid="ignore", over="ignore")  # targets that are not finite are refused later
    def step(self, action: Floats | NDArray[np.float32], q_setpoint: Floats) -> Target:
        """Return the new target.

        Args:
            action: (B, A) raw action; a row that is not finite changes only `finite`.
            q_setpoint: (B, n) rad, present setpoint.
        """
        np.isfinite(action).all(axis=1, out=self.finite)
        use = self.finite[:, None]
        np.copyto(self.last, np.minimum(np.maximum(action, self.low), self.high), where=use)
        value = (self.value if self._increments else self._offset) + self.scale * self.last
        if self._increments:
            value = np.minimum(np.maximum(value, q_setpoint - self.leash), q_setpoint + self.leash)
        elif self._change_max is not None:
            value = self.value + np.minimum(
                np.maximum(value - self.value, -self._change_max), self._change_max
            )
        np.copyto(self.value, value, where=use)
        return self.target

    @property
    def target(self) -> Target:
        """Present target."""
        return Target(drive=self._drive, value=self.value, finite=self.finite)
