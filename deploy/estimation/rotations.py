"""Rotations of B robots: unit quaternions (B, 4), w first, that turn vectors of the body into the world.

Products are of one robot's numbers with small constant tables, so its bits do not know how many others there are.

Source: Solà, Quaternion kinematics for the error-state Kalman filter (2017), sections 1, 2 and 4.
"""

import numpy as np

from robots.arrays import Floats

_LEFT = np.array([(1, -2, -3, -4), (2, 1, -4, 3), (3, 4, 1, -2), (4, -3, 2, 1)])
"""±n stands for the n-th entry of a in the matrix whose product with b is a ⊗ b."""
HAMILTON = np.sign(_LEFT)[:, None, :] * (np.abs(_LEFT)[:, None, :] == np.arange(1, 5)[:, None]).astype(float)
"""The k-th entry of a ⊗ b is the sum of HAMILTON[k, i, j] a_i b_j."""
PRODUCT = HAMILTON.reshape(4, 16)
SANDWICH = np.einsum("kmj,miv,j->kvij", HAMILTON[1:], HAMILTON[:, :, 1:], [1, -1, -1, -1]).reshape(9, 16)
"""What makes q ⊗ v ⊗ q* of q and q."""
CROSS = HAMILTON[1:, 1:, 1:].transpose(0, 2, 1).reshape(9, 3)


def exp(turn: Floats) -> Floats:
    """The quaternion of a rotation vector (B, 3) rad."""
    half = 0.5 * norm(turn)
    # np.sinc(x) is sin(πx)/(πx), and 1 where nothing turns.
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * turn], axis=1)


def product(a: Floats, b: Floats) -> Floats:
    """Of two quaternions, a ⊗ b, and of length 1 again: first b, then a."""
    q = times(PRODUCT, _pairs(a, b))
    return q / norm(q)


def matrix(quat_wxyz: Floats) -> Floats:
    """(B, 3, 3) R, whose product with a vector of the body is that vector in the world."""
    return times(SANDWICH, _pairs(quat_wxyz, quat_wxyz)).reshape(-1, 3, 3)


def skew(v: Floats) -> Floats:
    """(..., 3, 3) [v]×, whose product with u is v × u, of v (..., 3)."""
    return times(CROSS, v).reshape(*v.shape, 3)


def times(matrices: Floats, vectors: Floats) -> Floats:
    """(..., m) of (..., m, n) and (..., n)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def norm(v: Floats) -> Floats:
    """(B, 1) lengths of (B, n)."""
    return np.asarray(np.sqrt((v * v).sum(axis=1, keepdims=True)))


def upright(up: Floats) -> Floats:
    """The rotation without yaw under which `up` (B, 3), in the body, points up in the world."""
    roll, pitch = np.arctan2(up[:, 1], up[:, 2]), np.arctan2(-up[:, 0], np.hypot(up[:, 1], up[:, 2]))
    zero = np.zeros_like(roll)
    return product(exp(np.stack([zero, pitch, zero], axis=1)), exp(np.stack([roll, zero, zero], axis=1)))


def _pairs(a: Floats, b: Floats) -> Floats:
    return (a[:, :, None] * b[:, None, :]).reshape(-1, 16)
