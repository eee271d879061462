"""The stop that is ready to be sent: planned and checked one tick ahead."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from deploy.masks import all_true
from deploy.motion.drive_modes import DriveModes
from deploy.stage import Arrays, Stage
from deploy.state import DriveMode, Setpoint
from robots.arrays import Bools, Floats
from robots.capabilities import required

_SAVED = ("q", "qd", "qdd", "tau", "mode", "kp", "kd")
_NO_SETPOINT = Setpoint(q=np.array(np.nan), qd=np.array(np.nan), qdd=np.array(np.nan))


class PreparedStop(Stage):
    """First step of the stop that would begin at the setpoint sent last.

    Attributes:
        setpoint: (B, n) of that step; NaN where there is none. tau: (B, n) N·m, its feed-forward torque.
    """

    setpoint: Setpoint

    def __init__(self, drives: DriveModes) -> None:
        """Begin at rest at 0 rad, with the drives of a stop."""
        self._drives, rest = drives, np.zeros_like(drives.stop.kp)
        self._put(rest, rest, rest, drives.stop)
        self.tau = rest

    def _put(self, q: Floats, qd: Floats, qdd: Floats, drive: DriveMode) -> None:
        tau = np.full_like(q, np.nan) if self._drives.free else None
        self.setpoint = Setpoint(q=q, qd=qd, qdd=qdd, tau=tau, drive=drive)

    def prepare(self, rows: Bools, setpoint: Setpoint, tau: Floats) -> None:
        """Keep a stop where `rows` (B,) holds; elsewhere there is none any more."""
        self.setpoint, self.tau = select(rows, setpoint), tau

    def rest(self, rows: Bools, here: Setpoint) -> None:
        """Robots in `rows` (B,) rest at `here`, with the drives of a stop; others keep their stop."""
        before = self.setpoint
        self._put(here.q, here.qd, here.qdd, self._drives.stop)
        self.setpoint = select(~rows, before, self.setpoint)

    def save(self) -> Arrays:
        """Copies of the stop, and of how drives are to follow it."""
        arrays = *self.setpoint[:3], self.tau, *required(self.setpoint.drive)
        return {name: array.copy() for name, array in zip(_SAVED, arrays, strict=True)}

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put a saved stop back, bit for bit."""
        q, qd, qdd, tau, mode, kp, kd = (np.array(arrays[name]) for name in _SAVED)
        self._put(q, qd, qdd, DriveMode(mode, kp, kd))
        self.tau = tau


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
    if here is None or elsewhere is None or here is elsewhere:
        return here
    pick = rows[:, None]
    return DriveMode(
        mode=np.where(rows, here.mode, elsewhere.mode),
        kp=np.where(pick, here.kp, elsewhere.kp),
        kd=np.where(pick, here.kd, elsewhere.kd),
    )
