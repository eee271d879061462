"""Falls of a robot with a floating base, by ground truth."""

import numpy as np

from deploy.truth import BaseTruth
from eval.judge.tick_window import true_tilt
from robots.arrays import Bools, Floats
from robots.capabilities import required
from robots.models.nominal_model import imu_in_base, load_pinocchio
from robots.rotations import matrix
from robots.spec import RobotSpec


class FallCriterion:
    """Criterion of a fall: the base tilts too far, or its IMU is too low above the floor."""

    def __init__(self, spec: RobotSpec) -> None:
        """Take the limits of robot.toml, and where the IMU is.

        Raises:
            RobotError: the model, or the place of the IMU.
        """
        self._limits, self._imu = required(spec.base), imu_in_base(spec, load_pinocchio(spec)[0])

    def height(self, base: BaseTruth) -> Floats:
        """Return (B,) m, of the IMU above the floor."""
        return np.asarray(base.position[:, 2] + matrix(base.quat_wxyz)[:, 2] @ self._imu)

    def fallen(self, base: BaseTruth) -> Bools:
        """Return (B,) robots that fall, or have fallen."""
        tilted = true_tilt(base) > self._limits.tilt_max_rad
        return np.asarray(tilted | (self.height(base) < self._limits.height_min_m))
