"""Smoother of each control mode, and the modes in which drives follow the policy and its stops."""

from typing import NamedTuple

import numpy as np

from deploy.motion.free_smoother import RollingSmoother, TorqueSmoother
from deploy.motion.smoother import Smoother, VelocitySmoother
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
    own, shape = drive_gains(spec), (robots, spec.n)
    chosen = Gains(np.zeros(spec.n), np.zeros(spec.n)) if mode is ControlMode.TORQUE else gains or own
    held = Gains(*(np.where(chosen.kp > 0.0, *gains) for gains in zip(chosen, own, strict=True)))
    policy, stop = (
        DriveMode(
            np.full(robots, number, dtype=np.int64), *(np.broadcast_to(gain, shape).copy() for gain in each)
        )
        for number, each in ((mode, chosen), (mode if chosen.stiff else ControlMode.POSITION, held))
    )
    return DriveModes(policy, policy if chosen.stiff else stop, not chosen.stiff)


def make_smoother(spec: RobotSpec, modes: DriveModes) -> Smoother:
    """Return the smoother of the mode in which drives follow the policy."""
    mode, robots = ControlMode(int(modes.policy.mode[0])), len(modes.policy.mode)
    if mode is ControlMode.TORQUE:
        return TorqueSmoother(spec, modes.policy, modes.stop)
    if modes.free:
        return RollingSmoother(spec, modes.policy, modes.stop)
    return VelocitySmoother(spec, robots) if mode is ControlMode.VELOCITY else Smoother(spec, robots)
