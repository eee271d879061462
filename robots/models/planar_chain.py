"""Planar chain of three hinges: position of the tool, and points that it can reach, in closed form.

Points of the plane are complex numbers: a link turned by an angle is multiplied by exp(i angle).
Source: Craig, Introduction to Robotics, ch. 4: inverse kinematics of a planar arm, here with the third angle given.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from robots.arrays import Bools, Floats
from robots.errors import RobotError
from robots.models.nominal_model import load_pinocchio
from robots.models.pinocchio_model import tool_frame
from robots.spec import RobotSpec

LINKS = 3
PARALLEL = 1e-6
"""Largest sine of the angle between parallel axes."""
ACCURACY_M = 1e-6
"""m by which the tool of the nominal model may be off that of the chain: rounding in model.xml."""
PROBES = 64
"""Random poses in which the two are compared."""
SWEEP = 1001
"""Third angles tried for a point: with links of 0.3 m the border of what can be reached is 0.5 mm coarse at most."""
ROUNDING_RAD = 1e-9
"""rad by which half of a whole turn may be rounded."""

Points = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarChain:
    """Three parallel hinges that move the tool of a robot in a plane.

    Attributes:
        joints: (3,) places of the hinges in joint vectors.
        origin: (3,) m, world: the point of the plane on the axis of the first hinge.
        along, across: (3,) unit vectors in the plane: of the first link at zero angles, and of that turned by +90°.
        links: (3,) m, vectors from hinge to hinge and from the last one to the tool, at zero angles.
    """

    joints: tuple[int, ...]
    origin: Floats
    along: Floats
    across: Floats
    links: Points

    @classmethod
    @np.errstate(over="ignore", invalid="ignore")  # of places too far for a float: none is near enough
    def of_robot(cls, spec: RobotSpec) -> Self:
        """Find the chain in the robot's nominal model.

        Raises:
            RobotError: the robot has no tool, or one that moves otherwise.
        """
        model, _ = load_pinocchio(spec)
        data, frames = model.createData(), tool_frame(spec, model)
        if not frames:
            raise RobotError(f"{spec.folder / 'robot.toml'}: tool: missing, a planar chain moves one")
        pin.framesForwardKinematics(model, data, np.zeros(spec.n))
        axes = pin.computeJointJacobians(model, data, np.zeros(spec.n)).T[:, 3:]
        parallel = np.linalg.norm(np.cross(axes, axes[0]), axis=1) < PARALLEL
        joints = tuple(int(joint) for joint in np.flatnonzero(parallel))
        if len(joints) != LINKS:
            raise _not_planar(spec, f"{len(joints)} parallel to {spec.joint_names[0]}")
        tool = data.oMf[frames[0]].translation
        points = np.array([*(data.oMi[joint + 1].translation for joint in joints), tool])
        points -= np.outer((points - tool) @ axes[0], axes[0])  # on each axis, the point in the tool's plane
        if not np.linalg.norm(points[1] - points[0]) > ACCURACY_M:
            first, second = (spec.joint_names[joint] for joint in joints[:2])
            raise _not_planar(spec, f"{first} and {second} on one axis")
        chain = cls._through(points, joints, axes[0])
        q = np.random.default_rng(0).uniform(-np.pi, np.pi, (PROBES, spec.n))
        for pose in q:
            pin.framesForwardKinematics(model, data, pose)
            if not np.abs(chain.tool(pose) - data.oMf[frames[0]].translation).max() <= ACCURACY_M:
                raise _not_planar(spec, f"others that move the tool {spec.tool!r}, or turned axes")
        return chain

    @classmethod
    def _through(cls, points: Floats, joints: tuple[int, ...], axis: Floats) -> Self:
        """Return the chain through hinges and tool (4, 3) m at zero angles."""
        along = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
        across, steps = np.cross(axis, along), np.diff(points, axis=0)
        return cls(
            joints=joints,
            origin=points[0],
            along=along,
            across=across,
            links=steps @ along + 1j * (steps @ across),
        )

    def tool(self, q: Floats) -> Floats:
        """Return (..., 3) m, the tool in the world at joint angles (..., n) rad."""
        turned = np.exp(1j * np.cumsum(q[..., self.joints], axis=-1))
        return self.world((turned * self.links).sum(axis=-1))

    def world(self, points: Points) -> Floats:
        """Return (..., 3) m in the world of points (...) of the plane."""
        return np.asarray(
            self.origin + points.real[..., None] * self.along + points.imag[..., None] * self.across
        )

    @np.errstate(divide="ignore", invalid="ignore")
    def reaches(self, position: Floats, low: Floats, high: Floats) -> Bools:
        """Return (K,) positions (K, 3) m in the plane that the tool reaches with hinges from `low` to `high` (3,) rad.

        The third angle is swept; the first two follow from it, with the elbow on either side, up to whole turns.
        """
        third = np.linspace(low[2], min(high[2], low[2] + 2 * np.pi), SWEEP)
        outer = self.links[1] + self.links[2] * np.exp(1j * third)
        offset = position - self.origin
        point = (offset @ self.along + 1j * (offset @ self.across))[:, None]
        first = self.links[0]
        cosine = (abs(point) ** 2 - abs(first) ** 2 - abs(outer) ** 2) / (2 * abs(first) * abs(outer))
        bend = np.arccos(np.clip(cosine, -1.0, 1.0))
        found = np.zeros(cosine.shape, dtype=bool)
        for side in (1.0, -1.0):
            second = np.angle(np.exp(1j * side * bend) * first / outer)
            turn = np.angle(point / (first + outer * np.exp(1j * second)))
            inside = _within(second, low[1], high[1]) & _within(turn, low[0], high[0])
            found |= inside & (abs(cosine) <= 1.0)
        return np.asarray(found.any(axis=1))


def _within(angle: Floats, low: float, high: float) -> Bools:
    """Return angles (...) rad that are in a range, up to whole turns; all are in a range of a whole turn."""
    middle, half = (low + high) / 2, (high - low) / 2
    offset = angle - middle
    offset -= 2 * np.pi * np.round(offset / (2 * np.pi))
    return np.asarray((np.abs(offset) <= half) | (half > np.pi - ROUNDING_RAD))


def _not_planar(spec: RobotSpec, found: str) -> RobotError:
    return RobotError(
        f"{spec.model_path}: expected {LINKS} parallel hinges that alone move the tool, in a plane; found {found}"
    )
