"""The stop that is ready to be sent: planned and checked one tick ahead."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from deploy.masks import all_true
from deploy.stage import Arrays, Stage
from deploy.state import DriveMode, Setpoint
from robots.arrays import Bools, Floats

_NO_SETPOINT = Setpoint(q=np.array(np.nan), qd=np.array(np.nan), qdd=np.array(np.nan))


class PreparedStop(Stage):
    """First step of the stop that would begin at the setpoint sent last.

    Attributes:
        setpoint: (B, n) of that step; NaN where there is none. tau: (B, n) N·m, its feed-forward torque.
    """

    def __init__(self, robots: int, n: int, drive: DriveMode | None = None) -> None:
        """Begin at rest at 0 rad; `drive` is that of stops, None if it is the same as that of the policy."""
        rest, self._drive = np.zeros((robots, n)), drive
        self.setpoint, self.tau = self._stop(rest, rest, rest), rest

    def _stop(self, q: Floats, qd: Floats, qdd: Floats) -> Setpoint:
        tau = None if self._drive is None else np.full_like(q, np.nan)
        return Setpoint(q=q, qd=qd, qdd=qdd, tau=tau, drive=self._drive)

    def prepare(self, rows: Bools, setpoint: Setpoint, tau: Floats) -> None:
        """Keep a stop where `rows` (B,) holds; elsewhere there is none any more."""
        self.setpoint, self.tau = select(rows, setpoint), tau

    def rest(self, rows: Bools, here: Setpoint) -> None:
        """Robots in `rows` (B,) rest at `here`; others keep their stop."""
        self.setpoint = select(~rows, self.setpoint, self._stop(*here[:3]))

    def save(self) -> Arrays:
        """Copies of the stop."""
        arrays = zip(("q", "qd", "qdd", "tau"), (*self.setpoint[:3], self.tau), strict=True)
        return {name: array.copy() for name, array in arrays}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put a saved stop back, bit for bit."""
        q, qd, qdd, self.tau = (np.array(arrays[name], dtype=float) for name in ("q", "qd", "qdd", "tau"))
        self.setpoint = self._stop(q, qd, qdd)


def select(rows: Bools, here: Setpoint, elsewhere: Setpoint = _NO_SETPOINT) -> Setpoint:
    """Return `here` where `rows` (B,) holds and `elsewhere` in other rows; NaN, which is never sent, by default."""
    if all_true(rows):
        return here
    pick = rows[:, None]
    return Setpoint(
        q=np.where(pick, here.q, elsewhere.q),
        qd=np.where(pick, here.qd, elsewhere.qd),
        qdd=np.where(pick, here.qdd, elsewhere.qdd),
        tau=here.tau
        if here.tau is None or elsewhere.tau is None
        else np.where(pick, here.tau, elsewhere.tau),
        drive=_drive(rows, here.drive, elsewhere.drive),
    )


def _drive(rows: Bools, here: DriveMode | None, elsewhere: DriveMode | None) -> DriveMode | None:
    if here is None or elsewhere is None:
        return here
    pick = rows[:, None]
    return DriveMode(
        mode=np.where(rows, here.mode, elsewhere.mode),
        kp=np.where(pick, here.kp, elsewhere.kp),
        kd=np.where(pick, here.kd, elsewhere.kd),
    )
