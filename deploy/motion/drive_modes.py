"""Modes in which drives follow the policy and its stops."""

from typing import NamedTuple

import numpy as np

from deploy.state import DriveMode
from robots.motors.control_mode import ControlMode
from robots.motors.drive_gains import drive_gains
from robots.motors.gains import Gains
from robots.spec import RobotSpec


class DriveModes(NamedTuple):
    """Modes of the drives of B robots.

    Attributes:
        policy: while they follow the policy. stop: in every other state.
        free: some drives hold no angle while they follow the policy: the two modes differ.
    """

    policy: DriveMode
    stop: DriveMode
    free: bool


def drive_modes(spec: RobotSpec, mode: ControlMode, gains: Gains | None, robots: int) -> DriveModes:
    """Return the modes for the control mode and the gains of a contract; None: the drives' own gains."""
    own = drive_gains(spec)
    chosen = Gains(np.zeros(spec.n), np.zeros(spec.n)) if mode is ControlMode.TORQUE else gains or own
    if chosen.stiff:
        policy = _drives(mode, chosen, robots)
        return DriveModes(policy, policy, free=False)
    held = Gains(*(np.where(chosen.kp > 0.0, *gains) for gains in zip(chosen, own, strict=True)))
    stop = _drives(ControlMode.POSITION, held, robots)
    return DriveModes(_drives(mode, chosen, robots), stop, free=True)


def position_drives(spec: RobotSpec, robots: int) -> DriveMode:
    """Return position drives with the robot's own gains."""
    return _drives(ControlMode.POSITION, drive_gains(spec), robots)


def _drives(mode: ControlMode, gains: Gains, robots: int) -> DriveMode:
    numbers = (np.tile(gain, (robots, 1)) for gain in (gains.kp, gains.kd))
    return DriveMode(np.full(robots, mode, dtype=np.int64), *numbers)
