"""Motion model of a floating base: how the IMU's measurements move the state and its errors.

    error  slice    quantity                                        unit    frame
    φ      0:3      orientation, R_true = exp(φ) R                  rad     world
    δv     3:6      velocity, v_true = v + δv                       m/s     base
    δb_g   6:9      bias of the gyro, b_true = b + δb               rad/s   base
    δb_a   9:12     bias of the accelerometer                       m/s²    base

Motion over dt, by the trapezoidal rule (0: begin, 1: end; w, a: gyro and accelerometer without bias):

    ΔR = exp(dt (w0 + w1)/2)                          R' = R ΔR
    c  = ΔRᵀ (v + dt/2 a0) + dt R'ᵀ g                 v' = c + dt/2 a1,     g = (0, 0, −G) in the world

Errors after the motion are F times the errors before it, plus noise of covariance Q:

             φ            δv     δb_g        δb_a
    F = φ [  I            0      −R' dt      0     ]        Q = [ R'    ]     [ R'    ]ᵀ     [ 0      ]
       δv [  dt R'ᵀ [g]×  ΔRᵀ    −[c]× dt    −I dt ]            [ [c]×  ] q_g [ [c]×  ]   +  [  q_a I ]
     δb_g [  0            0      I           0     ]
     δb_a [  0            0      0           I     ]        q_g = gyro² dt + angular_acceleration² u            rad²
                                                            q_a = accelerometer² dt + jerk² u                   m²/s²

    u: s³, see `error_transition`. The biases' rows of Q are diagonal: gyro_walk² dt, accelerometer_walk² dt.

Source: Solà, Quaternion kinematics for the error-state Kalman filter (2017), sections 5 and 7, here with velocity in
the base frame.
"""

from typing import NamedTuple

import numpy as np

from deploy.estimation.floating_base.base_measurements import BaseNoise
from robots.arrays import Floats
from robots.rotations import exp, matrix, matvec, product, skew

G = 9.81
"""m/s²."""
PHI, V, GYRO, ACC = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Slices of the errors."""


class NominalState(NamedTuple):
    """Nominal state: quat_wxyz (B, 4), velocity (B, 3) m/s in the base frame, bias (B, 6) of gyro and accelerometer."""

    quat_wxyz: Floats
    velocity: Floats
    bias: Floats


class Motion(NamedTuple):
    """Nominal state after a motion, in the symbols above.

    Attributes:
        quat_wxyz: (B, 4). R: (B, 3, 3), R' of it. velocity: (B, 3) m/s, v'.
        turn_back: (B, 3, 3), ΔRᵀ. coasting: (B, 3) m/s, c.
    """

    quat_wxyz: Floats
    R: Floats
    velocity: Floats
    turn_back: Floats
    coasting: Floats


def move(nominal: NominalState, dt: Floats, before: Floats, after: Floats) -> Motion:
    """Return the state after dt (B,) s; gyro and accelerometer (B, 6) rad/s and m/s² as `before` and `after` it."""
    lag, before, after = dt[:, None], before - nominal.bias, after - nominal.bias
    turn = exp(0.5 * lag * (before + after)[:, :3])
    quat_wxyz = product(nominal.quat_wxyz, turn)
    R, turn_back = matrix(quat_wxyz), matrix(turn).swapaxes(1, 2)
    coasting = matvec(turn_back, nominal.velocity + 0.5 * lag * before[:, 3:]) - G * lag * R[:, 2]
    return Motion(quat_wxyz, R, coasting + 0.5 * lag * after[:, 3:], turn_back, coasting)


def error_transition(motion: Motion, noise: BaseNoise, dt: Floats, unseen: Floats) -> tuple[Floats, Floats]:
    """Return the rows of φ and δv: F (B, 6, 12), exact where it turns, else of first order in dt; Q (B, 6, 6).

    Args:
        motion: of dt (B,) s.
        noise: of the IMU.
        unseen: (B,) s³, variance that the integral of a random walk of density 1 gains between lost samples.
    """
    R, lag = motion.R, dt[:, None]
    by_gyro = np.concatenate([R, skew(motion.coasting)], axis=1)
    F = np.zeros((len(dt), 6, 12))
    diagonal(F[:, PHI, PHI])[:] = 1.0
    F[:, V, 0], F[:, V, 1] = (
        R[:, 1] * (-G * lag),
        R[:, 0] * (G * lag),
    )  # columns of dt R'ᵀ [g]×; the third is 0
    F[:, V, V] = motion.turn_back
    np.multiply(by_gyro, -lag[..., None], out=F[:, :, GYRO])
    diagonal(F[:, V, ACC])[:] = -lag
    q_gyro = noise.gyro**2 * dt + noise.angular_acceleration**2 * unseen
    q_accelerometer = noise.accelerometer**2 * dt + noise.jerk**2 * unseen
    Q = q_gyro[:, None, None] * (by_gyro @ by_gyro.swapaxes(1, 2))
    diagonal(Q[:, V, V])[:] += q_accelerometer[:, None]
    return F, Q


def diagonal(matrices: Floats) -> Floats:
    """Return a view of the diagonals: (B, n, n) → (B, n)."""
    return np.asarray(np.einsum("bii->bi", matrices))


def whiten(S: Floats, y: Floats) -> Floats:
    """Return L⁻¹ y (..., 3), where S = L Lᵀ (..., 3, 3): of unit covariance if S is that of y (..., 3)."""
    l00 = np.sqrt(S[..., 0, 0])
    l10, l20 = S[..., 1, 0] / l00, S[..., 2, 0] / l00
    l11 = np.sqrt(S[..., 1, 1] - l10 * l10)
    l21 = (S[..., 2, 1] - l20 * l10) / l11
    l22 = np.sqrt(S[..., 2, 2] - l20 * l20 - l21 * l21)
    w0 = y[..., 0] / l00
    w1 = (y[..., 1] - l10 * w0) / l11
    return np.stack([w0, w1, (y[..., 2] - l20 * w0 - l21 * w1) / l22], axis=-1)
