"""Capsules around the shapes of a model: what they are, or the thinnest that hold a mesh, a box or a cylinder."""

from dataclasses import dataclass

import mujoco
import numpy as np

from robots.arrays import Floats

AROUND = 32
"""Points of a circle that stand for all of it."""
ROUNDED = 4
"""Digits of a length in m."""
SHORT = 1e-3
"""m, the line of what is nearly a ball."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """A capsule in the frame of `body`, m."""

    body: str
    start: tuple[float, ...]
    end: tuple[float, ...]
    radius: float


def shape_of(model: mujoco.MjModel, geom: int) -> Shape | None:
    """The capsule of a shape; None for one without an end, as a plane."""
    body = model.body(model.geom_bodyid[geom]).name
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    if int(model.geom_type[geom]) in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE):
        radius, half = model.geom_size[geom, 0], max(model.geom_size[geom, 1], SHORT / 2)
        ends = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
    elif (points := _points(model, geom)) is not None:
        ends, radius = around(points)
    else:
        return None
    start, end = (ends @ turn.reshape(3, 3).T + model.geom_pos[geom]).round(ROUNDED).tolist()
    up = np.ceil(radius * 10**ROUNDED) / 10**ROUNDED
    return Shape(body=body, start=tuple(start), end=tuple(end), radius=float(up))


def _points(model: mujoco.MjModel, geom: int) -> Floats | None:
    """(P, 3) m, points of the shape's own frame whose hull holds it."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        return np.asarray(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], dtype=np.float64)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        angle = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
        rim = size[0] / np.cos(np.pi / AROUND) * np.stack((np.cos(angle), np.sin(angle)), axis=1)
        return np.concatenate([np.c_[rim, np.full(AROUND, z)] for z in (-size[1], size[1])])
    if kind in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        return np.asarray(corners * size)
    return None


def around(points: Floats) -> tuple[Floats, float]:
    """Ends (2, 3) and radius of the smallest capsule of three, along each principal axis, that holds all points."""
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=False)[2]
    capsules = [_along(points - middle, np.roll(axes, -i, axis=0)) for i in range(len(axes))]
    ends, radius = min(capsules, key=lambda found: _volume(*found))
    return ends + middle, radius


def _along(points: Floats, axes: Floats) -> tuple[Floats, float]:
    """About a line along the first axis through the middle of what is across it."""
    along, *across = axes @ points.T
    low, high = np.min(across, axis=1), np.max(across, axis=1)
    centre = (low + high) / 2.0
    distance = np.linalg.norm(np.transpose(across) - centre, axis=1)
    radius = max(float(distance.max()), SHORT)
    # The ball at an end reaches beyond it, the farther the nearer to the line.
    beyond = np.sqrt(np.maximum(radius**2 - distance**2, 0.0))
    start, end = float((along + beyond).min()), float((along - beyond).max())
    if end - start < SHORT:
        start = end = (start + end) / 2.0
        radius = float(np.hypot(along - start, distance).max())
        start, end = start - SHORT / 2, end + SHORT / 2
    return np.array([np.array([t, *centre]) @ axes for t in (start, end)]), radius


def _volume(ends: Floats, radius: float) -> float:
    return float(np.pi * radius**2 * (np.linalg.norm(ends[1] - ends[0]) + 4.0 / 3.0 * radius))
