"""What the judge must be told of the simulated world; the simulated robot's own record fits it."""

from typing import Protocol

from robots.arrays import Bools, Floats


class BaseTruth(Protocol):
    """Of a floating base."""

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
        """(B, 3) of length 1, world: against gravity, to which the floor need not be square."""


class Truth(Protocol):
    """What the simulation knows and the robot does not: arrays (B, ...), world frame."""

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
        """(B,) whether the robot touches itself or its table."""

    @property
    def contact_n(self) -> Floats:
        """(B,) N, normal force of the strongest contact."""

    @property
    def valid(self) -> Bools:
        """(B,) False once the simulation diverged: the row says nothing any more."""

    @property
    def base(self) -> BaseTruth | None:
        """Of a robot that has one."""
