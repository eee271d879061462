"""Soft start of drives: stiffness that rises after a robot is armed.

A robot is armed where its encoders say that it is. An error of theirs, 2.4 mrad of a worn encoder of arm6, would be a
torque of half of the drive's range in the first period, on top of the load that the brakes held. Drives that a contract
makes softer than the robot's own rise as fast as those: a quarter of their stiffness would let them sag. Legs that a
gantry lets go have to be stiff at once: this is for robots on a fixed base.
"""

import numpy as np

from deploy.masks import any_true
from deploy.state import DriveMode
from robots.arrays import Floats, Ints

FIRST_SHARE, RISE_S = 0.25, 0.1
"""Share of the stiffness at first, and s until all of it is there. Damping is not reduced."""


def soft_start(drive: DriveMode, own: Floats, ticks: Ints, dt: float) -> DriveMode:
    """Return drives whose stiffness is still rising `ticks` (B,) of dt s after robots were armed.

    `own` (n,) N·m/rad is the stiffness of the robot's own gains.
    """
    if not any_true(ticks < RISE_S / dt):
        return drive
    share = np.minimum(FIRST_SHARE + (1.0 - FIRST_SHARE) / RISE_S * dt * ticks, 1.0)
    return drive._replace(kp=np.minimum(drive.kp, share[:, None] * np.maximum(drive.kp, own)))
