"""Rotation of every link relative to the link before it, as Euler angles and as angular velocity."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from robots.arrays import Bools, Floats
from robots.models.nominal_model import load_pinocchio
from robots.spec import RobotSpec

if TYPE_CHECKING:
    from deploy.runtime import Runtime

GIMBAL = 1.0 - 1e-5
"""Sine of x from which on y and z cannot be told apart; z is then 0. Source: Godot 4, Basis::get_euler."""


class LinkRotations(NamedTuple):
    """Rotations R(q) = mean + sine · sin q + cosine · cos q of n links, each (n, 3, 3), from link to link before.

    Attributes:
        axis: (n, 3) joint axes in the links' axes.
        about_x: (n,) links that turn about x alone: x is then the whole angle.
    """

    mean: Floats
    sine: Floats
    cosine: Floats
    axis: Floats
    about_x: Bools


def link_rotations(spec: RobotSpec) -> LinkRotations:
    """Compute the rotations of the nominal model. Source: Rodrigues' formula, from three poses of each hinge."""
    model, _ = load_pinocchio(spec)
    at_0, at_quarter, at_half = (_relative(model, q) for q in (0.0, np.pi / 2, np.pi))
    mean, cosine = (at_0 + at_half) / 2, (at_0 - at_half) / 2
    sine = at_quarter - mean
    turn = at_0.swapaxes(1, 2) @ sine  # [axis]×
    axis = np.stack((turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]), axis=1)
    x = np.array([1.0, 0.0, 0.0])
    keeps_x = np.isclose(at_0 @ x, x).all(axis=1) & np.isclose(np.abs(axis), x).all(axis=1)
    return LinkRotations(mean, sine, cosine, axis, keeps_x)


def _relative(model: pin.Model, angle: float) -> Floats:
    data = model.createData()
    pin.forwardKinematics(model, data, np.full(model.nq, angle))
    return np.array([data.liMi[joint].rotation for joint in range(1, model.njoints)])


def euler_yxz(R: Floats, about_x: Bools) -> Floats:
    """Return (..., 3) rad, angles x, y, z with R = Ry Rx Rz of rotations (..., 3, 3); `about_x` as in `LinkRotations`.

    x is in [−π/2, π/2], of a link that turns about x alone in [−π, π]. Source: Godot 4, Basis::get_euler, order YXZ.
    """
    sin_x = -R[..., 1, 2]
    locked = np.abs(sin_x) >= GIMBAL
    x = np.arcsin(np.minimum(np.maximum(sin_x, -1.0), 1.0))
    y = np.arctan2(R[..., 0, 2], R[..., 2, 2])
    z = np.arctan2(R[..., 1, 0], R[..., 1, 1])
    y = np.where(locked, np.sign(sin_x) * np.arctan2(R[..., 0, 1], R[..., 0, 0]), y)
    free = ~about_x
    x = np.where(about_x, np.arctan2(sin_x, R[..., 1, 1]), x)
    return np.stack((x, y * free, z * (free & ~locked)), axis=-1)


def read_euler(runtime: "Runtime", links: LinkRotations) -> Floats:
    """Return (B, 3 n) rad, Euler angles of every link at the estimated joint angles."""
    q = runtime.state.q[..., None, None]
    R = links.mean + np.sin(q) * links.sine + np.cos(q) * links.cosine
    return euler_yxz(R, links.about_x).reshape(len(q), -1)


def read_rotation_rate(runtime: "Runtime", links: LinkRotations) -> Floats:
    """Return (B, 3 n) rad/s, angular velocity of every link relative to the link before, in the link's axes."""
    qd = runtime.state.qd
    return (qd[..., None] * links.axis).reshape(len(qd), -1)
