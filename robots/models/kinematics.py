"""Kinematics of robots at given joint angles: tool, feet, Jacobians, manipulability, self-collision."""

from typing import NamedTuple

import numpy as np

from robots.arrays import Bools, Floats, Ints
from robots.models.tool_jacobian import find_manipulability, find_torques, find_velocities


class Frames(NamedTuple):
    """Tool and feet of a robot with n joints.

    Attributes:
        has_tool: the first tracked point is the tool; the others are feet.
        home_sign: sign of det J of the tool in the home pose; 0 without tool.
        tool_joints: (K,) joints that carry the tool; none without tool.
        foot_joints: (F, n) 1 where a joint carries a foot, else 0.
        imu: (3,) m, in the frame of the root body; 0 without floating base.
    """

    has_tool: bool
    home_sign: float
    tool_joints: Ints
    foot_joints: Floats
    imu: Floats


class Kinematics:
    """Kinematics of B robots at the joint angles that were given to `Fleet.kinematics`.

    The arrays belong to this object: what the fleet computes later leaves them as they are. Positions and velocities
    are in the world; of a robot with a floating base, in the frame of its root body.
    """

    __slots__ = ("_colliding", "_frames", "_jacobians", "_points", "_tool")

    def __init__(
        self, frames: Frames, points: Floats, jacobians: Floats | None, colliding: Bools | None
    ) -> None:
        """Take what `Fleet.kinematics` computed.

        Args:
            frames: tool and feet of the robot.
            points: (B, F, 3) m, tool, if any, and feet.
            jacobians: (B, 6, n) of the point at the origin; None where they were not computed.
            colliding: (B,) shapes are too near; None where it was not computed.
        """
        self._frames, self._points, self._jacobians, self._colliding = frames, points, jacobians, colliding
        self._tool = points[:, 0] if frames.has_tool else None

    @property
    def tool_position(self) -> Floats:
        """(B, 3) m, the tool."""
        if self._tool is None:
            raise RuntimeError("tool position: the robot has no tool")
        return self._tool

    @property
    def colliding(self) -> Bools:
        """(B,) robots with two shapes nearer than the collision margin; q must be inside the working ranges."""
        if self._colliding is None:
            raise RuntimeError("self-collision: the fleet was built without collisions")
        return self._colliding

    @property
    def _jacobian(self) -> Floats:
        if self._jacobians is None:
            raise RuntimeError("velocity or manipulability: kinematics were computed without Jacobians")
        return self._jacobians

    def tool_velocity(self, qd: Floats, robots: Ints | None = None) -> Floats:
        """Return (R, 3) m/s, the tool's velocity of R `robots`, by default all, at joint speeds (R, n) rad/s.

        Raises:
            ValueError: there are not speeds for each of them.
        """
        all_robots, _, n = self._jacobian.shape
        rows, found = np.arange(all_robots) if robots is None else robots, np.empty((len(qd), 3))
        if qd.shape != (len(rows), n):
            raise ValueError(f"joint speeds: found shape {qd.shape}, expected {(len(rows), n)}")
        find_velocities(self._jacobian, self.tool_position, self._frames.tool_joints, rows, qd, found)
        return found

    def torque_of_tool_force(self, force: Floats) -> Floats:
        """Return (B, n) N·m, the joint torques Jᵀf that equal a force f (B, 3) N on the tool.

        Raises:
            ValueError: there is not a force for each robot.
        """
        robots, _, n = self._jacobian.shape
        found = np.empty((robots, n))
        if force.shape != (robots, 3):
            raise ValueError(f"force on the tool: found shape {force.shape}, expected {(robots, 3)}")
        find_torques(self._jacobian, self.tool_position, self._frames.tool_joints, force, found)
        return found

    def manipulability(self) -> Floats:
        """Return (B,) √det(JᵀJ), or √det(JJᵀ) for more than six joints: 0 in a singularity.

        For six joints it is det J with the sign that makes the home pose's positive. That sign changes in a singularity
        only, so below 0 the robot is beyond one. It is the same for every point that moves with the tool. Only joints
        that carry the tool count.
        """
        found = np.empty(len(self._jacobian))
        find_manipulability(self._jacobian, self.tool_position, self._frames.tool_joints, found)
        return self._frames.home_sign * found

    @property
    def _feet(self) -> Floats:
        return self._points[:, self._frames.has_tool :]

    @property
    def feet_position(self) -> Floats:
        """(B, F, 3) m, the feet relative to the IMU."""
        return self._feet - self._frames.imu

    def feet_velocity(self, qd: Floats) -> Floats:
        """Return (B, F, 3) m/s, the feet relative to the IMU, for joint speeds (B, n) rad/s."""
        leg_speeds = (self._frames.foot_joints * qd[:, None]).swapaxes(1, 2)
        twist = (self._jacobian @ leg_speeds).swapaxes(1, 2)
        return np.asarray(twist[..., :3] + np.cross(twist[..., 3:], self._feet))
