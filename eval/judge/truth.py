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


def base_velocity_and_tilt(base: BaseTruth) -> tuple[Floats, Floats]:
    """Velocity of a floating base over the ground, and its tilt off gravity.

    Returns:
        (B, 3) m/s forwards, m/s to the left, rad/s to the left; (B,) rad.
    """
    w, x, y, z = base.quat_wxyz.T
    # First and last column of the rotation matrix: directions of the base's x and z axes in the world.
    heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    upwards = 1.0 - 2.0 * (x * x + y * y)
    cos, sin, (vx, vy, _) = np.cos(heading), np.sin(heading), base.velocity.T
    # Last row of the rotation matrix: vertical component of each axis of the base.
    up = np.stack((2.0 * (x * z - w * y), 2.0 * (y * z + w * x), upwards), axis=1)
    turning = (up * base.angular_velocity).sum(axis=1)
    velocity = np.stack((cos * vx + sin * vy, cos * vy - sin * vx, turning), axis=1)
    # Last column: direction of the base's z axis in the world.
    axis = np.stack((2.0 * (x * z + w * y), 2.0 * (y * z - w * x), upwards), axis=1)
    return velocity, np.arccos(np.minimum(np.maximum((axis * base.up).sum(axis=1), -1.0), 1.0))
