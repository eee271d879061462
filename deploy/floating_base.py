"""How the base of a legged robot stands and moves: an error-state Kalman filter of its IMU and its standing feet.

Each robot's belief is orientation R, velocity v in the base frame, and the biases of gyro and accelerometer, at the
time its newest IMU sample was TAKEN; `BaseState` is that belief carried forward to now. The IMU predicts; a foot that
stands does not move in the world, so v + ω × p + ṗ = 0 up to slip.

    errors (12): orientation φ in the world, R_true = exp(φ) R; velocity; gyro bias; accelerometer bias

With velocity in the base frame the feet are linear in the errors and know nothing of φ, and gravity does not see a turn
about itself: yaw is unobservable in the equations as it is in the world, and no linearization can pretend otherwise.

Source: Bloesch et al., State estimation for legged robots: consistent fusion of leg kinematics and IMU (2012); Solà,
Quaternion kinematics for the error-state Kalman filter (2017), sections 5 to 7, for the errors in continuous and
discrete time. filterpy is the oracle of the tests.
"""

from typing import NamedTuple

import numpy as np

from deploy.base_state import BaseNoise, BaseState, Feet, Imu
from deploy.flags import some
from deploy.rotations import exp, matrix, norm, product, skew, times, upright
from deploy.stage import Stage
from deploy.state import Bools, Floats

G = 9.81
"""m/s²."""
RANGE = 1e4
"""rad/s, m/s² or m: a reading beyond it is no reading."""
GATE = 16.27
"""A standing foot is further off than this once in a thousand: χ² of 3 degrees of freedom."""
STUCK_SAMPLES = 10
"""So many equal samples in a row are no sensor's noise."""
REST_BAND = (0.8, 1.2)
"""Share of G that a robot which is still measures: a filter is seeded from no other sample."""
SEED_ACCELERATION_STD, SEED_SPEED_STD = 0.3, 0.5
"""m/s², m/s: how much a robot may move when it is seeded."""
NIS_SAMPLES, NIS_MAX = 100, 4 * GATE
"""Window of the mean squared innovation, and what one sample may add to it."""
TILT_STD_MAX, SPEED_STD_MAX = 0.5, 2.0
"""rad, m/s: who knows less has lost the base."""

PHI, V, GYRO, ACC = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
SEEN = slice(3, 9)
"""The errors that a foot sees."""


class _Motion(NamedTuple):
    """Where a belief gets to: R (B, 3, 3) of `quat_wxyz`; its errors go by F (B, 6, 12) and Q (B, 6, 6)."""

    quat_wxyz: Floats
    R: Floats
    velocity: Floats
    F: Floats
    Q: Floats


class FloatingBase(Stage):
    """Orientation and velocity of B bases; `P` (B, 12, 12) is the covariance of their errors.

    A foot whose innovation is beyond `GATE` is left out. A filter has diverged where its tilt or speed is unknown beyond
    `TILT_STD_MAX` or `SPEED_STD_MAX`, is not finite, or even the best of its feet is on average beyond the gate.
    """

    carried = (
        *("quat_wxyz", "velocity", "gyro_bias", "accelerometer_bias", "P", "gyro", "accelerometer"),
        *("t_sample", "seeded", "repeats", "innovation", "nis"),
    )

    def __init__(self, noise: BaseNoise, dt: float, robots: int, feet: int) -> None:
        """Allocate.

        Args:
            noise: of the IMU and the feet.
            dt: s, period of the IMU's samples.
            robots: B.
            feet: F.
        """
        self.quat_wxyz = np.tile([1.0, 0.0, 0.0, 0.0], (robots, 1))
        self.velocity, self.gyro_bias, self.accelerometer_bias = np.zeros((3, robots, 3))
        self.gyro, self.accelerometer = np.zeros((2, robots, 3))
        self.P, self.innovation = np.zeros((robots, 12, 12)), np.zeros((robots, feet, 3))
        self.t_sample, self.nis = np.zeros(robots), np.zeros(robots)
        self.seeded, self.repeats = np.zeros(robots, dtype=bool), np.zeros((robots, 2), dtype=np.int64)
        self._noise, self._dt = noise, dt
        self._walk = np.repeat([noise.gyro_walk**2, noise.accelerometer_walk**2], 3)
        self._foot_var = noise.slip**2 / dt
        self._H = np.tile(np.eye(3, 6), (robots, feet, 1, 1))

    def reset(self, ids: Bools) -> None:
        """Forget robots where `ids` (B,) holds; their next sample at rest seeds them."""
        self.seeded[ids] = False

    def step(self, t: float, imu: Imu, feet: Feet) -> BaseState:
        """Fuse what arrived and carry the belief to now.

        A packet older than the last, more than a period from the future, or with numbers that no sensor gives is left
        out, as if it had never arrived.

        Args:
            t: s, now.
            imu: the newest packets.
            feet: at the times of these packets.
        """
        arrived = imu.fresh & np.isfinite(imu.t) & (imu.t <= t + self._dt)
        arrived &= _credible(imu.gyro, imu.accelerometer)
        newer = arrived & self.seeded & (imu.t > self.t_sample)
        if some(arrived & ~self.seeded):
            self._seed(arrived & ~self.seeded, imu)
        self._count_repeats(newer, imu)
        fused = newer & ~self._stuck()
        self._predict(fused, imu)
        self._update(fused, feet)
        return self._now(t)

    def _seed(self, ids: Bools, imu: Imu) -> None:
        """The first sample is a measurement of tilt by gravity, as wrong as the accelerometer's unknown bias."""
        force = norm(imu.accelerometer)[:, 0]
        ids = ids & (force >= REST_BAND[0] * G) & (force <= REST_BAND[1] * G)
        noise, n = self._noise, np.count_nonzero(ids)
        quat_wxyz = upright(imu.accelerometer[ids])
        bias_var = noise.accelerometer_bias**2
        tilt_var = (bias_var + SEED_ACCELERATION_STD**2) / G**2
        P = np.zeros((n, 12, 12))
        _diagonal(P)[:] = np.repeat([tilt_var, SEED_SPEED_STD**2, noise.gyro_bias**2, bias_var], 3)
        P[:, 2, 2] = 0.0  # yaw is counted from here
        tilt_by_bias = skew(np.array([0.0, 0.0, bias_var / G])) @ matrix(quat_wxyz)
        P[:, PHI, ACC], P[:, ACC, PHI] = tilt_by_bias, tilt_by_bias.swapaxes(1, 2)
        self.P[ids], self.quat_wxyz[ids] = P, quat_wxyz
        self.velocity[ids], self.gyro_bias[ids], self.accelerometer_bias[ids] = 0.0, 0.0, 0.0
        self.gyro[ids], self.accelerometer[ids] = imu.gyro[ids], imu.accelerometer[ids]
        self.innovation[ids], self.nis[ids], self.repeats[ids] = 0.0, 0.0, 0
        self.t_sample[ids], self.seeded[ids] = imu.t[ids], True

    def _count_repeats(self, newer: Bools, imu: Imu) -> None:
        """Gyro and accelerometer each, for one of them may hang alone."""
        pairs = ((imu.gyro, self.gyro), (imu.accelerometer, self.accelerometer))
        same = np.stack([(new == last).all(axis=1) for new, last in pairs], axis=1)
        np.copyto(self.repeats, np.where(same, self.repeats + 1, 0), where=newer[:, None])

    def _stuck(self) -> Bools:
        return np.asarray((self.repeats >= STUCK_SAMPLES - 1).any(axis=1))

    def _predict(self, fused: Bools, imu: Imu) -> None:
        """From the last sample to this one, with what the IMU measured at both ends."""
        rows = fused[:, None]
        dt = np.where(fused, imu.t - self.t_sample, 0.0)
        gyro, force = (
            np.where(rows, imu.gyro, self.gyro),
            np.where(rows, imu.accelerometer, self.accelerometer),
        )
        missing = np.maximum(dt - self._dt, 0.0) ** 3 / 12  # a random walk between two known ends
        motion = self._move(dt, 0.5 * (self.gyro + gyro), force, missing)
        FP, P = motion.F @ self.P, self.P
        P[:, :6, 6:] = FP[:, :, 6:]
        P[:, 6:, :6] = FP[:, :, 6:].swapaxes(1, 2)
        P[:, :6, :6] = FP @ motion.F.swapaxes(1, 2) + motion.Q
        _diagonal(P[:, 6:, 6:])[:] += self._walk * dt[:, None]
        np.copyto(self.quat_wxyz, motion.quat_wxyz, where=rows)
        self.velocity[:], self.gyro[:], self.accelerometer[:] = motion.velocity, gyro, force
        self.t_sample += dt

    def _move(self, dt: Floats, gyro: Floats, force: Floats, missing: Floats) -> _Motion:
        """The belief `dt` (B,) s on, and to first order in dt what its errors become; exact where they turn.

        Args:
            dt: s.
            gyro: (B, 3) rad/s as measured, mean over dt.
            force: (B, 3) m/s² as measured at the end of dt.
            missing: (B,) s³, integral of the variance of motion that nobody saw.
        """
        lag, noise = dt[:, None], self._noise
        turn = exp((gyro - self.gyro_bias) * lag)
        quat_wxyz = product(self.quat_wxyz, turn)
        R, back = matrix(quat_wxyz), matrix(turn).swapaxes(1, 2)
        before, after = (0.5 * lag * (f - self.accelerometer_bias) for f in (self.accelerometer, force))
        carried = times(back, self.velocity + before) - G * lag * R[:, 2]
        by_gyro = np.concatenate(
            [R, skew(carried)], axis=1
        )  # what an error of the gyro does in 1 s, but for its sign
        F = np.zeros((len(dt), 6, 12))
        _diagonal(F[:, PHI, PHI])[:] = 1.0
        F[:, V, 0], F[:, V, 1] = R[:, 1] * (-G * lag), R[:, 0] * (G * lag)
        F[:, V, V] = back
        np.multiply(by_gyro, -lag[..., None], out=F[:, :, GYRO])
        _diagonal(F[:, V, ACC])[:] = -lag
        turned = noise.gyro**2 * dt + noise.angular_acceleration**2 * missing
        pushed = noise.accelerometer**2 * dt + noise.jerk**2 * missing
        Q = turned[:, None, None] * (by_gyro @ by_gyro.swapaxes(1, 2))
        _diagonal(Q[:, V, V])[:] += pushed[:, None]
        return _Motion(quat_wxyz, R, carried + after, F, Q)

    def _update(self, fused: Bools, feet: Feet) -> None:
        """All feet at once, in the six errors that they see; a foot that is left out weighs nothing.

        The sum of their information instead of the inverse of their covariance: the same filter, with a matrix of six
        rows however many feet there are.

        Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), sec. 7.2.
        """
        stands = feet.stance & fused[:, None] & _credible(feet.position, feet.velocity)
        rows, arm = stands[..., None], self._H[..., 3:]
        arm[:] = skew(np.where(rows, feet.position, 0.0))
        moved = np.where(rows, feet.velocity, 0.0) - times(arm, (self.gyro - self.gyro_bias)[:, None])
        residual = -(self.velocity[:, None] + moved)
        used = self._gate(fused, stands, residual)
        robots, n = stands.shape
        H, z = self._H.reshape(robots, 3 * n, 6), residual.reshape(robots, 3 * n, 1)
        weighed = (self._H * (used / self._foot_var)[..., None, None]).reshape(H.shape).swapaxes(1, 2)
        information = np.concatenate([weighed @ H, weighed @ z], axis=2)
        seen = self.P[:, :, SEEN]
        change = seen @ np.linalg.solve(np.eye(6) + information[..., :6] @ seen[:, SEEN], information)
        self._correct(change[..., 6])
        self.P -= change[..., :6] @ seen.swapaxes(1, 2)
        self.P[:] = 0.5 * (self.P + self.P.swapaxes(1, 2))

    def _gate(self, fused: Bools, stands: Bools, residual: Floats) -> Bools:
        """Which feet agree with the belief (B, F); keeps their innovations and how far off the best of them is."""
        H = self._H
        HP = (H.reshape(len(H), -1, 6) @ self.P[:, SEEN, SEEN]).reshape(H.shape)
        S = HP @ H.swapaxes(2, 3) + self._foot_var * np.eye(3)
        white = np.where(stands[..., None], _whiten(S, residual), 0.0)
        np.copyto(self.innovation, white, where=fused[:, None, None])
        nis = (white * white).sum(axis=2)
        best = np.where(stands, nis, NIS_MAX).min(axis=1)
        self.nis += np.where(stands.any(axis=1), (best - self.nis) / NIS_SAMPLES, 0.0)
        return np.asarray(stands & (nis <= GATE))

    def _correct(self, error: Floats) -> None:
        """Put the errors (B, 12) into the belief, which leaves them 0."""
        moved = error.any(axis=1)[:, None]
        np.copyto(self.quat_wxyz, product(exp(error[:, PHI]), self.quat_wxyz), where=moved)
        self.velocity += error[:, V]
        self.gyro_bias += error[:, GYRO]
        self.accelerometer_bias += error[:, ACC]

    def _now(self, t: float) -> BaseState:
        noise = self._noise
        age = np.where(self.seeded, t - self.t_sample, np.inf)
        lag = np.where(self.seeded, np.maximum(age, 0.0), 0.0)
        quat_wxyz, R, velocity, F, Q = self._move(lag, self.gyro, self.accelerometer, lag**3 / 3)
        P = F @ self.P @ F.swapaxes(1, 2) + Q
        velocity_in_world = times(R, velocity)
        to_world = np.concatenate([-skew(velocity_in_world), R], axis=2)
        to_gravity = -R.swapaxes(1, 2) @ skew(np.array([0.0, 0.0, 1.0]))
        var = _diagonal(P)
        tilt_var, speed_var = var[:, :2].sum(axis=1), var[:, V].max(axis=1)
        known = (tilt_var <= TILT_STD_MAX**2) & (speed_var <= SPEED_STD_MAX**2) & (self.nis <= GATE)
        gyro_var = noise.gyro**2 / self._dt + noise.angular_acceleration**2 * lag + self._walk[0] * lag
        return BaseState(
            t=t,
            quat_wxyz=quat_wxyz,
            angular_velocity=self.gyro - self.gyro_bias,
            velocity_in_world=velocity_in_world,
            velocity_in_base=velocity,
            gravity=-R[:, 2],
            orientation_var=var[:, PHI],
            angular_velocity_var=_diagonal(self.P[:, GYRO, GYRO]) + gyro_var[:, None],
            velocity_in_world_var=_variance(to_world, P),
            velocity_in_base_var=var[:, V],
            gravity_var=_variance(to_gravity, P[:, PHI, PHI]),
            age=age,
            innovation=self.innovation,
            stuck=self._stuck(),
            diverged=self.seeded & ~known,
        )


def _diagonal(matrices: Floats) -> Floats:
    """A view of the diagonals (B, n) of (B, n, n)."""
    return np.asarray(np.einsum("bii->bi", matrices))


def _credible(*readings: Floats) -> Bools:
    """Whether all of (..., 3) are numbers that a sensor can give."""
    return np.asarray((np.abs(np.concatenate(readings, axis=-1)) <= RANGE).all(axis=-1))


def _whiten(S: Floats, y: Floats) -> Floats:
    """L⁻¹ y (..., 3) of S = L Lᵀ (..., 3, 3): of unit covariance if S is that of y."""
    l00 = np.sqrt(S[..., 0, 0])
    l10, l20 = S[..., 1, 0] / l00, S[..., 2, 0] / l00
    l11 = np.sqrt(S[..., 1, 1] - l10 * l10)
    l21 = (S[..., 2, 1] - l20 * l10) / l11
    l22 = np.sqrt(S[..., 2, 2] - l20 * l20 - l21 * l21)
    w0 = y[..., 0] / l00
    w1 = (y[..., 1] - l10 * w0) / l11
    return np.stack([w0, w1, (y[..., 2] - l20 * w0 - l21 * w1) / l22], axis=-1)


def _variance(J: Floats, P: Floats) -> Floats:
    """(B, m) diagonals of J P Jᵀ."""
    return np.asarray(((J @ P) * J).sum(axis=2))
