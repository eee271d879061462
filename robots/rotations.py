"""Rotations of B robots: unit quaternions (B, 4), w first, that turn vectors of the body into the world.

Products use the numbers of one robot and small constant tables: its bits do not depend on the number of robots.

Source: Solà, Quaternion kinematics for the error-state Kalman filter (2017), sections 1, 2 and 4.
"""

import numpy as np

from robots.arrays import Floats

_LEFT = np.array([(1, -2, -3, -4), (2, 1, -4, 3), (3, 4, 1, -2), (4, -3, 2, 1)])
"""Matrix of a in a ⊗ b = matrix · b; ±n stands for the n-th entry of a."""
HAMILTON = np.sign(_LEFT)[:, None, :] * (np.abs(_LEFT)[:, None, :] == np.arange(1, 5)[:, None]).astype(float)
"""(a ⊗ b)_k = Σ HAMILTON[k, i, j] a_i b_j."""
PRODUCT = HAMILTON.reshape(4, 16)
SANDWICH = np.einsum("kmj,miv,j->kvij", HAMILTON[1:], HAMILTON[:, :, 1:], [1, -1, -1, -1]).reshape(9, 16)
"""Coefficients of R in the products q_i q_j, from q ⊗ v ⊗ q*."""
CROSS = HAMILTON[1:, 1:, 1:].transpose(0, 2, 1).reshape(9, 3)


def exp(rotation_vector: Floats) -> Floats:
    """Return the quaternions (B, 4) of rotation vectors (B, 3) rad."""
    half = 0.5 * norm(rotation_vector)
    # np.sinc(x) is sin(πx)/(πx), and 1 at 0.
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * rotation_vector], axis=1)


def product(a: Floats, b: Floats) -> Floats:
    """Return a ⊗ b, normalized: first b, then a."""
    q = matvec(PRODUCT, _pairs(a, b))
    return q / norm(q)


def matrix(quat_wxyz: Floats) -> Floats:
    """Return R (B, 3, 3), which turns a vector of the body into the world."""
    return matvec(SANDWICH, _pairs(quat_wxyz, quat_wxyz)).reshape(-1, 3, 3)


def skew(v: Floats) -> Floats:
    """Return [v]× (..., 3, 3) of v (..., 3); its product with u is v × u."""
    return matvec(CROSS, v).reshape(*v.shape, 3)


def matvec(matrices: Floats, vectors: Floats) -> Floats:
    """Batched matrix-vector product. Shapes: (..., m, n), (..., n) → (..., m)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def norm(v: Floats) -> Floats:
    """Return lengths (B, 1) of vectors (B, n)."""
    return np.asarray(np.sqrt((v * v).sum(axis=1, keepdims=True)))


def from_up(up: Floats) -> Floats:
    """Return the rotation without yaw under which `up` (B, 3), in the body, points up in the world."""
    roll, pitch = np.arctan2(up[:, 1], up[:, 2]), np.arctan2(-up[:, 0], np.hypot(up[:, 1], up[:, 2]))
    zero = np.zeros_like(roll)
    return product(exp(np.stack([zero, pitch, zero], axis=1)), exp(np.stack([roll, zero, zero], axis=1)))


def _pairs(a: Floats, b: Floats) -> Floats:
    return (a[:, :, None] * b[:, None, :]).reshape(-1, 16)
