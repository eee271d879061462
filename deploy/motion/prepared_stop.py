"""The stop that is ready to be sent: planned and checked one tick ahead."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from deploy.masks import all_true
from deploy.stage import Arrays, Stage
from deploy.state import Setpoint
from robots.arrays import Bools, Floats

_NO_SETPOINT = Setpoint(q=np.array(np.nan), qd=np.array(np.nan), qdd=np.array(np.nan))


class PreparedStop(Stage):
    """First step of the stop that would begin at the setpoint sent last.

    Attributes:
        setpoint: (B, n) of that step; NaN where there is none. tau: (B, n) N·m, its feed-forward torque.
    """

    def __init__(self, robots: int, n: int) -> None:
        rest = np.zeros((robots, n))
        self.setpoint, self.tau = Setpoint(q=rest, qd=rest, qdd=rest), rest

    def prepare(self, rows: Bools, setpoint: Setpoint, tau: Floats) -> None:
        """Keep a stop where `rows` (B,) holds; elsewhere there is none any more."""
        self.setpoint, self.tau = select(rows, setpoint), tau

    def rest(self, rows: Bools, here: Setpoint) -> None:
        """Robots in `rows` (B,) rest at `here`; others keep their stop."""
        self.setpoint = select(~rows, self.setpoint, here)

    def save(self) -> Arrays:
        """Copies of the stop."""
        return {name: array.copy() for name, array in (*self.setpoint._asdict().items(), ("tau", self.tau))}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put a saved stop back, bit for bit."""
        q, qd, qdd, self.tau = (np.array(arrays[name], dtype=float) for name in ("q", "qd", "qdd", "tau"))
        self.setpoint = Setpoint(q=q, qd=qd, qdd=qdd)


def select(rows: Bools, here: Setpoint, elsewhere: Setpoint = _NO_SETPOINT) -> Setpoint:
    """Return `here` where `rows` (B,) holds and `elsewhere` in other rows; NaN, which is never sent, by default."""
    if all_true(rows):
        return here
    pick = rows[:, None]
    return Setpoint(
        q=np.where(pick, here.q, elsewhere.q),
        qd=np.where(pick, here.qd, elsewhere.qd),
        qdd=np.where(pick, here.qdd, elsewhere.qdd),
    )
