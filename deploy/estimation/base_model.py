"""How the belief about a floating base and its errors move, by what the IMU measured.

    errors (12): orientation φ in the world, R_true = exp(φ) R; velocity in the base; biases of gyro and accelerometer

Source: Solà, Quaternion kinematics for the error-state Kalman filter (2017), sections 5 and 7, here with velocity in
the base frame.
"""

from typing import NamedTuple

import numpy as np

from deploy.estimation.base_measurements import BaseNoise
from deploy.estimation.rotations import exp, matrix, product, skew, times
from robots.arrays import Floats

G = 9.81
"""m/s²."""
PHI, V, GYRO, ACC = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Places of the errors."""


class Belief(NamedTuple):
    """What is estimated: velocity (B, 3) m/s in the base frame, bias (B, 6) of gyro and accelerometer."""

    quat_wxyz: Floats
    velocity: Floats
    bias: Floats


class Motion(NamedTuple):
    """Where a belief gets to: R (B, 3, 3) of `quat_wxyz`.

    `back` (B, 3, 3) undoes the turn; `carried` (B, 3) is the velocity before the acceleration at the end.
    """

    quat_wxyz: Floats
    R: Floats
    velocity: Floats
    back: Floats
    carried: Floats


def move(belief: Belief, dt: Floats, before: Floats, after: Floats) -> Motion:
    """The belief after dt by the trapezoidal rule.

    Args:
        belief: at the beginning.
        dt: (B,) s.
        before: (B, 6) rad/s and m/s², gyro and accelerometer at the beginning.
        after: (B, 6) the same at the end.
    """
    lag, before, after = dt[:, None], before - belief.bias, after - belief.bias
    turn = exp(0.5 * lag * (before + after)[:, :3])
    quat_wxyz = product(belief.quat_wxyz, turn)
    R, back = matrix(quat_wxyz), matrix(turn).swapaxes(1, 2)
    carried = times(back, belief.velocity + 0.5 * lag * before[:, 3:]) - G * lag * R[:, 2]
    return Motion(quat_wxyz, R, carried + 0.5 * lag * after[:, 3:], back, carried)


def spread(motion: Motion, noise: BaseNoise, dt: Floats, unseen: Floats) -> tuple[Floats, Floats]:
    """What a motion makes of the errors, exact where it turns, else of first order in dt.

    Args:
        motion: of dt (B,) s.
        noise: of the IMU.
        unseen: (B,) s³, variance that a random walk of density 1 gains in its integral while nobody looks.

    Returns:
        F (B, 6, 12), Q (B, 6, 6): the first six errors are F times what all errors were, and noise of covariance Q.
    """
    R, lag = motion.R, dt[:, None]
    # What too small a turn, in the base, does to φ and velocity.
    by_turn = np.concatenate([R, skew(motion.carried)], axis=1)
    F = np.zeros((len(dt), 6, 12))
    diagonal(F[:, PHI, PHI])[:] = 1.0
    F[:, V, 0], F[:, V, 1] = R[:, 1] * (-G * lag), R[:, 0] * (G * lag)
    F[:, V, V] = motion.back
    np.multiply(by_turn, -lag[..., None], out=F[:, :, GYRO])
    diagonal(F[:, V, ACC])[:] = -lag
    turned = noise.gyro**2 * dt + noise.angular_acceleration**2 * unseen
    pushed = noise.accelerometer**2 * dt + noise.jerk**2 * unseen
    Q = turned[:, None, None] * (by_turn @ by_turn.swapaxes(1, 2))
    diagonal(Q[:, V, V])[:] += pushed[:, None]
    return F, Q


def diagonal(matrices: Floats) -> Floats:
    """A view of the diagonals (B, n) of (B, n, n)."""
    return np.asarray(np.einsum("bii->bi", matrices))


def whiten(S: Floats, y: Floats) -> Floats:
    """L⁻¹ y (..., 3) of S = L Lᵀ (..., 3, 3): of unit covariance if S is that of y."""
    l00 = np.sqrt(S[..., 0, 0])
    l10, l20 = S[..., 1, 0] / l00, S[..., 2, 0] / l00
    l11 = np.sqrt(S[..., 1, 1] - l10 * l10)
    l21 = (S[..., 2, 1] - l20 * l10) / l11
    l22 = np.sqrt(S[..., 2, 2] - l20 * l20 - l21 * l21)
    w0 = y[..., 0] / l00
    w1 = (y[..., 1] - l10 * w0) / l11
    return np.stack([w0, w1, (y[..., 2] - l20 * w0 - l21 * w1) / l22], axis=-1)
