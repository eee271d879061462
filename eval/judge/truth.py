"""Ground truth that the judge reads, as protocols; the truth of the simulated robot implements them."""

from typing import Protocol

import numpy as np

from robots.arrays import Bools, Floats


class BaseTruth(Protocol):
    """Motion of a floating base."""

    @property
    def position(self) -> Floats:
        """(B, 3) m, world."""

    @property
    def quat_wxyz(self) -> Floats:
        """(B, 4) base in world."""

    @property
    def velocity(self) -> Floats:
        """(B, 3) m/s, world."""

    @property
    def angular_velocity(self) -> Floats:
        """(B, 3) rad/s, base frame."""

    @property
    def up(self) -> Floats:
        """(B, 3) unit vector against gravity, world. The floor need not be perpendicular to it."""


class Truth(Protocol):
    """State of the simulation after a tick: arrays (B, ...), world frame."""

    @property
    def q(self) -> Floats:
        """(B, n) rad."""

    @property
    def qd(self) -> Floats:
        """(B, n) rad/s."""

    @property
    def tau(self) -> Floats:
        """(B, n) N·m of the actuators, at the joint."""

    @property
    def winding_c(self) -> Floats:
        """(B, n) °C."""

    @property
    def tool_position(self) -> Floats:
        """(B, 3) m."""

    @property
    def tool_velocity(self) -> Floats:
        """(B, 3) m/s."""

    @property
    def self_collision(self) -> Bools:
        """(B,) the robot touches itself or its table."""

    @property
    def contact_n(self) -> Floats:
        """(B,) N, normal force of the strongest contact."""

    @property
    def valid(self) -> Bools:
        """(B,) False once the simulation diverged: the row means nothing from then on."""

    @property
    def base(self) -> BaseTruth | None:
        """Floating base; None for a robot without one."""


def true_tilt(base: BaseTruth) -> Floats:
    """(B,) rad, angle between the base's z axis and the direction against gravity."""
    w, x, y, z = base.quat_wxyz.T
    # Last column of the rotation matrix: direction of the base's z axis in the world.
    axis = np.stack((2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)), axis=1)
    return np.asarray(np.arccos(np.minimum(np.maximum((axis * base.up).sum(axis=1), -1.0), 1.0)))
