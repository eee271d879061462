"""Escalation of repeated stops: a policy that is refused again and again gets no further try."""

import numpy as np

from deploy.stage import Stage
from robots.arrays import Bools, Ints
from robots.spec import RobotSpec

_NEVER = -(1 << 62)


class StopEscalation(Stage):
    """Memory of the last stops of B robots.

    Attributes:
        begun: (B, N) ticks at which the last N stops began since the last progress, newest first; N is
            `Margins.stops_max`. progress: (B,) of the task at the newest of them.
    """

    carried = ("begun", "progress")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Begin without any stop."""
        self.begun = np.full((robots, spec.margins.stops_max), _NEVER, dtype=np.int64)
        self.progress = np.zeros(robots, dtype=np.int64)
        self._window = round(spec.margins.stops_s / spec.dt)

    def reset(self, ids: Bools) -> None:
        """Forget the stops of robots where `ids` (B,) holds."""
        self.begun[ids] = _NEVER

    def step(self, tick: int, begins: Bools, progress: Ints) -> Bools:
        """Return (B,) robots whose stop makes N within the window, without progress in between.

        Args:
            tick: of now. begins: (B,) robots whose stop begins. progress: (B,) a number that grows with the task.
        """
        self.reset(begins & (progress != self.progress))
        self.progress[begins] = progress[begins]
        self.begun[begins, 1:] = self.begun[begins, :-1]
        self.begun[begins, 0] = tick
        return np.asarray(begins & (tick - self.begun[:, -1] < self._window))
