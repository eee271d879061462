"""Kinematics and dynamics of many equal robots by the nominal model.

A `Fleet` computes up to `BLOCK` robots in one call of Pinocchio: 0.7 µs of inverse dynamics per six-joint robot against
4 µs for a call each. More robots use the same block one after another, whose data stay in the cache.
"""

import copy

import numpy as np
import pinocchio as pin

from robots.arrays import Floats
from robots.models.blocks import block_rows
from robots.models.kinematics import Kinematics
from robots.models.side_by_side import Blocks
from robots.spec import RobotSpec

SLIDING = 0.05
"""rad/s at which a joint has three quarters of its dry friction."""


class Fleet:
    """Kinematics and dynamics of B equal robots; arrays (B, ...).

    Attributes:
        robots: B.
        n: joints of each.
    """

    def __init__(self, spec: RobotSpec, robots: int, *, collisions: bool = False) -> None:
        """Build the block; with `collisions`, `kinematics` includes self-collision.

        Raises:
            RobotError: as `load_pinocchio`, or the home pose is too near a singularity or a self-collision.
        """
        self.n, self._checks_collisions = spec.n, collisions
        self._blocks = Blocks(spec, collisions=collisions)
        self._resize(robots)

    def resized(self, robots: int) -> "Fleet":
        """Return a fleet of another size, which shares the block with this one where it is as wide.

        Two such fleets must not be used from two threads.
        """
        other = copy.copy(self)
        other._resize(robots)
        return other

    def _resize(self, robots: int) -> None:
        self.robots, self._rows = robots, block_rows(robots, self.n)
        self._block = self._blocks.block(self._rows[0].stop)

    def torque(self, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Return (B, n) N·m by recursive Newton-Euler, rotor inertia included, friction not.

        Source: Featherstone, Rigid Body Dynamics Algorithms (2008), table 5.1.
        """
        block, torque = self._block, np.empty((self.robots, self.n))
        for rows in self._rows:
            tau = pin.rnea(block.model, block.data, q[rows].ravel(), qd[rows].ravel(), qdd[rows].ravel())
            torque[rows] = tau.reshape(-1, self.n)
        return torque

    def acceleration(self, q: Floats, qd: Floats, tau: Floats) -> Floats:
        """Return (B, n) rad/s² under motor torques (B, n) N·m by the articulated-body algorithm, friction included.

        Source: Featherstone, Rigid Body Dynamics Algorithms (2008), table 7.1.
        """
        block, moving, acceleration = self._block, tau - self.friction(qd), np.empty((self.robots, self.n))
        for rows in self._rows:
            qdd = pin.aba(block.model, block.data, q[rows].ravel(), qd[rows].ravel(), moving[rows].ravel())
            acceleration[rows] = qdd.reshape(-1, self.n)
        return acceleration

    def friction(self, qd: Floats) -> Floats:
        """Return (R, n) N·m of damping and dry friction at speeds (R, n) rad/s, smooth around rest."""
        return np.asarray(self._blocks.damping * qd + self._blocks.dry_friction * np.tanh(qd / SLIDING))

    def kinematics(self, q: Floats, *, jacobians: bool = True) -> Kinematics:
        """Return kinematics, and self-collision if the fleet has it, at joint angles (B, n) rad.

        Without `jacobians`, for velocities and manipulability, it takes half of the time.
        """
        block = self._block
        points = np.empty((self.robots, *block.points.shape[1:]))
        jacobian = np.empty((self.robots, 6, self.n)) if jacobians else None
        colliding = np.zeros(self.robots, dtype=bool) if self._checks_collisions else None
        for rows in self._rows:
            if jacobian is None:
                pin.forwardKinematics(block.model, block.data, q[rows].ravel())
            else:
                found = pin.computeJointJacobians(block.model, block.data, q[rows].ravel())
                jacobian[rows] = found.reshape(6, -1, self.n).transpose(1, 0, 2)
            pin.updateFramePlacements(block.model, block.data)
            points[rows] = block.points
            if block.collisions and colliding is not None:
                colliding[rows] = block.collisions.check(block.model, block.data)
        return Kinematics(self._blocks.frames, points, jacobian, colliding)

    def nearest_shapes(self, poses: Floats) -> tuple[float, str, str]:
        """Return the least distance, m, between two shapes in any of the poses (P, n) rad, and the shapes' names.

        Infinite, and without names, where no pair can meet; poses that are not finite are left out.
        """
        return self._blocks.nearest_shapes(poses)

    def least_gaps(self, poses: Floats) -> Floats:
        """Return (P,) m, the least distance between two shapes in each pose (P, n) rad; infinite without pairs."""
        return self._blocks.least_gaps(poses)
