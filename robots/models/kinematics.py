"""Kinematics of robots at given joint angles: tool, feet, Jacobians, manipulability, self-collision."""

from typing import NamedTuple

import numpy as np

from robots.arrays import Bools, Floats, Ints

_CROSS = np.array(
    [[0, 0, 0, 0, 0, 1, 0, -1, 0], [0, 0, -1, 0, 0, 0, 1, 0, 0], [0, 1, 0, -1, 0, 0, 0, 0, 0]],
    dtype=np.float64,
)
"""p @ _CROSS, in rows of three, is the matrix M of w × p = M w."""


class Frames(NamedTuple):
    """Tool and feet of a robot with n joints.

    Attributes:
        has_tool: the first tracked point is the tool; the others are feet.
        home_sign: sign of det J of the tool in the home pose; 0 without tool.
        tool_joints: (n,) joints that carry the tool; None where all do.
        foot_joints: (F, n) 1 where a joint carries a foot, else 0.
        imu: (3,) m, in the frame of the root body; 0 without floating base.
    """

    has_tool: bool
    home_sign: float
    tool_joints: Bools | None
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

    def _tool_jacobian(self, robots: slice | Ints) -> Floats:
        jacobian, joints = self._jacobian[robots], self._frames.tool_joints
        return jacobian if joints is None else jacobian * joints

    def tool_velocity(self, qd: Floats, robots: slice | Ints = slice(None)) -> Floats:
        """Return (R, 3) m/s, the tool's velocity of R `robots` at joint speeds (R, n) rad/s."""
        jacobian, crossing = self._tool_jacobian(robots), _crossing(self.tool_position[robots])
        twist: Floats = np.matvec(jacobian, qd)
        return np.asarray(twist[:, :3] + np.matvec(crossing, twist[:, 3:]))

    def torque_of_tool_force(self, force: Floats) -> Floats:
        """Return (B, n) N·m, the joint torques Jᵀf that equal a force f (B, 3) N on the tool."""
        wrench = np.concatenate((force[:, None], force[:, None] @ _crossing(self.tool_position)), axis=2)
        return np.asarray((wrench @ self._tool_jacobian(slice(None)))[:, 0])

    def manipulability(self) -> Floats:
        """Return (B,) √det(JᵀJ), or √det(JJᵀ) for more than six joints: 0 in a singularity.

        For six joints it is det J with the sign that makes the home pose's positive. That sign changes in a singularity
        only, so below 0 the robot is beyond one. It is the same for every point that moves with the tool. Only joints
        that carry the tool count.

        Source: Yoshikawa, Manipulability of Robotic Mechanisms (1985), eq. 4.
        """
        jacobian, joints = self._jacobian, self._frames.tool_joints
        if joints is not None:
            jacobian = jacobian[:, :, joints]
        if jacobian.shape[2] != 6:
            jacobian = jacobian.copy()
            jacobian[:, :3] += _crossing(self.tool_position) @ jacobian[:, 3:]
        return self._frames.home_sign * yoshikawa(jacobian)

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


def _crossing(position: Floats) -> Floats:
    """Return (R, 3, 3), M of w × p = M w at positions p (R, 3).

    Pinocchio's Jacobian gives the velocity of the point at the origin: w × p moves it to the tool.
    """
    return (position @ _CROSS).reshape(-1, 3, 3)


def yoshikawa(jacobian: Floats) -> Floats:
    """Return (R,) det J of tool Jacobians (R, 6, 6), Yoshikawa's measure of others (R, 6, n)."""
    n = jacobian.shape[2]
    if n == 6:
        det: Floats = np.linalg.det(jacobian)
        return det
    transposed = jacobian.transpose(0, 2, 1)
    gram = transposed @ jacobian if n < 6 else jacobian @ transposed
    return np.asarray(np.sqrt(np.maximum(np.linalg.det(gram), 0.0)))
