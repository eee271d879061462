"""Capsules of a model's shapes: as they are, or the smallest around a mesh, a box or a cylinder."""

from dataclasses import dataclass

import mujoco
import numpy as np

from robots.arrays import Floats

CIRCLE_POINTS = 32
"""Points that approximate a circle."""
DECIMALS = 4
"""Decimals of a length in m."""
LENGTH_MIN = 1e-3
"""m, smallest length of a capsule's segment."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Capsule:
    """A capsule in the frame of `body`, m."""

    body: str
    start: tuple[float, ...]
    end: tuple[float, ...]
    radius: float


def capsule_of(model: mujoco.MjModel, geom: int) -> Capsule | None:
    """Return the capsule of a shape; None for an infinite shape such as a plane."""
    body = model.body(model.geom_bodyid[geom]).name
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    if int(model.geom_type[geom]) in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE):
        radius, half = model.geom_size[geom, 0], max(model.geom_size[geom, 1], LENGTH_MIN / 2)
        ends = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
    elif (points := _points(model, geom)) is not None:
        ends, radius = enclosing_capsule(points)
    else:
        return None
    start, end = (ends @ rotation.reshape(3, 3).T + model.geom_pos[geom]).round(DECIMALS).tolist()
    up = np.ceil(radius * 10**DECIMALS) / 10**DECIMALS
    return Capsule(body=body, start=tuple(start), end=tuple(end), radius=float(up))


def _points(model: mujoco.MjModel, geom: int) -> Floats | None:
    """Return points (P, 3) m in the shape's frame whose convex hull contains it."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        return np.asarray(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], dtype=np.float64)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS, endpoint=False)
        rim = size[0] / np.cos(np.pi / CIRCLE_POINTS) * np.stack((np.cos(angle), np.sin(angle)), axis=1)
        return np.concatenate([np.c_[rim, np.full(CIRCLE_POINTS, z)] for z in (-size[1], size[1])])
    if kind in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        return np.asarray(corners * size)
    return None


def enclosing_capsule(points: Floats) -> tuple[Floats, float]:
    """Ends (2, 3) and radius of the smallest capsule of three, along each principal axis, that holds all points."""
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=False)[2]
    capsules = [_capsule_along(points - middle, np.roll(axes, -i, axis=0)) for i in range(len(axes))]
    ends, radius = min(capsules, key=lambda found: _volume(*found))
    return ends + middle, radius


def _capsule_along(points: Floats, axes: Floats) -> tuple[Floats, float]:
    """Return the capsule along the first axis through the centre of the extent across it."""
    along, *across = axes @ points.T
    low, high = np.min(across, axis=1), np.max(across, axis=1)
    centre = (low + high) / 2.0
    distance = np.linalg.norm(np.transpose(across) - centre, axis=1)
    radius = max(float(distance.max()), LENGTH_MIN)
    # The end caps extend beyond the segment, most of all near its axis.
    beyond = np.sqrt(np.maximum(radius**2 - distance**2, 0.0))
    start, end = float((along + beyond).min()), float((along - beyond).max())
    if end - start < LENGTH_MIN:
        start = end = (start + end) / 2.0
        radius = float(np.hypot(along - start, distance).max())
        start, end = start - LENGTH_MIN / 2, end + LENGTH_MIN / 2
    return np.array([np.array([t, *centre]) @ axes for t in (start, end)]), radius


def _volume(ends: Floats, radius: float) -> float:
    return float(np.pi * radius**2 * (np.linalg.norm(ends[1] - ends[0]) + 4.0 / 3.0 * radius))
