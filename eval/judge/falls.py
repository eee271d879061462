"""Falls of a robot with a floating base, by ground truth."""

from typing import NamedTuple

import numpy as np

from deploy.truth import BaseTruth
from robots.arrays import Bools, Floats
from robots.capabilities import required
from robots.models.nominal_model import imu_in_base, load_pinocchio
from robots.rotations import matrix
from robots.spec import RobotSpec


class Posture(NamedTuple):
    """Posture of B robots with a floating base.

    Attributes:
        tilt: (B,) rad, angle between the base's z axis and the direction against gravity.
        height: (B,) m, of the IMU above the floor.
        fallen: (B,) the base tilts too far or is too low: the robot falls, or has fallen.
    """

    tilt: Floats
    height: Floats
    fallen: Bools


class FallCriterion:
    """Fall criterion of a robot: largest tilt of its base and least height of its IMU."""

    def __init__(self, spec: RobotSpec) -> None:
        """Take the limits of robot.toml, and where the IMU is.

        Raises:
            RobotError: the model, or the place of the IMU.
        """
        self._limits, self._imu = required(spec.base), imu_in_base(spec, load_pinocchio(spec)[0])

    def measure(self, base: BaseTruth) -> Posture:
        """Return how robots stand."""
        rotation = matrix(base.quat_wxyz)
        tilt = np.arccos(np.clip(np.vecdot(rotation[:, :, 2], base.up), -1.0, 1.0))
        height = base.position[:, 2] + rotation[:, 2] @ self._imu
        fallen = (tilt > self._limits.tilt_max_rad) | (height < self._limits.height_min_m)
        return Posture(tilt, height, np.asarray(fallen))
