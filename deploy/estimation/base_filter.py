"""How the base of a legged robot stands and moves: an error-state Kalman filter of its IMU and its standing feet.

Each robot's belief is orientation R, velocity v in the base frame, and the biases of gyro and accelerometer, at the
time its newest gyro sample was TAKEN; `BaseState` is that belief carried forward to now. The IMU predicts; a foot that
stands does not move in the world, so v + ω × p + ṗ = 0 up to slip.

With the velocity in the base frame and the error of orientation in the world's, feet are linear in the errors and do
not see that of orientation, and gravity does not see a turn about itself: yaw is unobservable in the equations as it
is in the world, and no linearization can pretend otherwise.

Source: Bloesch et al., State estimation for legged robots: consistent fusion of leg kinematics and IMU (2012); Solà,
Quaternion kinematics for the error-state Kalman filter (2017), sections 5 to 7, for the errors in continuous and
discrete time. filterpy is the oracle of the tests.
"""

import numpy as np

from deploy.estimation.base_measurements import BaseNoise, Feet, Imu, Upright
from deploy.estimation.base_model import ACC, PHI, Belief, G, V, diagonal, move, spread, whiten
from deploy.estimation.rotations import exp, matrix, norm, product, skew, times, upright
from deploy.masks import any_true
from deploy.stage import Stage
from deploy.state import BaseState
from robots.arrays import Bools, Floats

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
CONTRADICTED = 5
"""So often in a row the IMU's own word of up may be beyond the gate: a blow to it is over by then."""
NIS_SAMPLES, NIS_MAX = 100, 4 * GATE
"""Window of the mean squared innovation, and what one sample may add to it."""
TILT_STD_MAX, SPEED_STD_MAX = 0.5, 2.0
"""rad, m/s: who knows less has lost the base."""

SEEN = slice(3, 9)
"""The errors that a foot sees."""


class FloatingBase(Stage):
    """Orientation and velocity of B bases; `P` (B, 12, 12) is the covariance of their errors.

    A foot whose innovation is beyond `GATE` is left out. A filter has diverged where its tilt or speed was unknown
    beyond `TILT_STD_MAX` or `SPEED_STD_MAX`, is not finite, or even the best of its feet is on average beyond the gate;
    and where what the IMU says of up was beyond it `CONTRADICTED` times in a row.
    """

    carried = (
        "quat_wxyz",
        "velocity",
        "bias",
        "P",
        "reading",
        "t_sample",
        "t_force",
        "seeded",
        "repeats",
        "innovation",
        "nis",
        "contradicted",
    )

    def __init__(self, noise: BaseNoise, dt: float, robots: int, feet: int) -> None:
        """Allocate.

        Args:
            noise: of the IMU and the feet.
            dt: s, period of the IMU's samples.
            robots: B.
            feet: F.
        """
        self.quat_wxyz, self.velocity = np.tile([1.0, 0.0, 0.0, 0.0], (robots, 1)), np.zeros((robots, 3))
        self.bias, self.reading = np.zeros((2, robots, 6))  # gyro, accelerometer
        self.P, self.innovation = np.zeros((robots, 12, 12)), np.zeros((robots, feet, 3))
        self.t_sample, self.t_force, self.nis = np.zeros((3, robots))
        self.seeded, self.repeats = np.zeros(robots, dtype=bool), np.zeros((robots, 2), dtype=np.int64)
        self.contradicted = np.zeros(robots, dtype=np.int64)
        self._noise, self._dt = noise, dt
        self._belief = Belief(self.quat_wxyz, self.velocity, self.bias)
        self._walk = np.repeat([noise.gyro_walk**2, noise.accelerometer_walk**2], 3)
        self._foot_var = noise.slip**2 / dt
        self._H = np.tile(np.eye(3, 6), (robots, feet, 1, 1))

    def reset(self, ids: Bools) -> None:
        """Forget robots where `ids` (B,) holds; their next sample at rest seeds them."""
        self.seeded[ids] = False

    @np.errstate(all="ignore")  # where numbers run out `diverged` says so
    def step(self, t: float, imu: Imu, feet: Feet | None, upright: Upright | None = None) -> BaseState:
        """Fuse what arrived and carry the belief to now.

        A packet older than the last, more than a period from the future, or with numbers that no sensor gives is left
        out, as if it had never arrived. A gyro goes on with what the accelerometer said last, for as long as it may
        be old.

        Args:
            t: s, now.
            imu: the newest packets.
            feet: at the times of these packets; None: nobody looked at them.
            upright: of an IMU that says it.
        """
        reading = np.concatenate([imu.gyro, imu.accelerometer], axis=1)
        known = np.isfinite(imu.t) & np.isfinite(imu.t_accelerometer)
        known &= np.maximum(imu.t, imu.t_accelerometer) <= t + self._dt
        arrived = imu.fresh & known & _credible(reading)
        newer = arrived & self.seeded & (imu.t > self.t_sample)
        if any_true(arrived & ~self.seeded):
            self._seed(arrived & ~self.seeded, imu, reading)
        self._count_repeats(newer, imu.t_accelerometer, reading)
        fused = newer & ~self._stuck()
        self._predict(fused, imu.t, reading)
        if feet is not None:
            self._update(fused, feet)
        if upright is not None:
            self._level(upright.fresh & self.seeded, upright)
        return self._now(t)

    def _seed(self, ids: Bools, imu: Imu, reading: Floats) -> None:
        """The first sample is a measurement of tilt by gravity, as wrong as the accelerometer's unknown bias."""
        force = norm(reading[:, 3:])[:, 0]
        ids = ids & (force >= REST_BAND[0] * G) & (force <= REST_BAND[1] * G)
        noise, n = self._noise, np.count_nonzero(ids)
        quat_wxyz = upright(reading[ids, 3:])
        bias_var = noise.accelerometer_bias**2
        tilt_var = (bias_var + SEED_ACCELERATION_STD**2) / G**2
        P = np.zeros((n, 12, 12))
        diagonal(P)[:] = np.repeat([tilt_var, SEED_SPEED_STD**2, noise.gyro_bias**2, bias_var], 3)
        P[:, 2, 2] = 0.0  # yaw is counted from here
        tilt_by_bias = skew(np.array([0.0, 0.0, bias_var / G])) @ matrix(quat_wxyz)
        P[:, PHI, ACC], P[:, ACC, PHI] = tilt_by_bias, tilt_by_bias.swapaxes(1, 2)
        self.P[ids], self.quat_wxyz[ids] = P, quat_wxyz
        self.velocity[ids], self.bias[ids], self.reading[ids] = 0.0, 0.0, reading[ids]
        self.innovation[ids], self.nis[ids], self.repeats[ids], self.contradicted[ids] = 0.0, 0.0, 0, 0
        self.t_sample[ids], self.t_force[ids], self.seeded[ids] = imu.t[ids], imu.t_accelerometer[ids], True

    def _count_repeats(self, newer: Bools, t_force: Floats, reading: Floats) -> None:
        """Gyro and accelerometer each, for one of them may hang alone; who says nothing repeats nothing."""
        same = (reading == self.reading).reshape(-1, 2, 3).all(axis=2)
        new = np.stack([newer, newer & (t_force > self.t_force)], axis=1)
        np.copyto(self.repeats, (self.repeats + 1) * same, where=new)
        np.copyto(self.t_force, t_force, where=new[:, 1])

    def _stuck(self) -> Bools:
        return np.asarray((self.repeats >= STUCK_SAMPLES - 1).any(axis=1))

    def _predict(self, fused: Bools, t: Floats, reading: Floats) -> None:
        """From the last sample to this one, with what the IMU measured at both ends."""
        rows = fused[:, None]
        dt, reading = np.where(fused, t - self.t_sample, 0.0), np.where(rows, reading, self.reading)
        unseen = np.maximum(dt - self._dt, 0.0) ** 3 / 12  # between two ends that are known
        motion = move(self._belief, dt, self.reading, reading)
        F, Q = spread(motion, self._noise, dt, unseen)
        FP, P = F @ self.P, self.P
        P[:, :6, 6:] = FP[:, :, 6:]
        P[:, 6:, :6] = FP[:, :, 6:].swapaxes(1, 2)
        P[:, :6, :6] = FP @ F.swapaxes(1, 2) + Q
        diagonal(P[:, 6:, 6:])[:] += self._walk * dt[:, None]
        np.copyto(self.quat_wxyz, motion.quat_wxyz, where=rows)
        self.velocity[:], self.reading[:] = motion.velocity, reading
        self.t_sample += dt

    def _update(self, fused: Bools, feet: Feet) -> None:
        """All feet at once, in the six errors that they see; a foot that is left out weighs nothing.

        The sum of their information instead of the inverse of their covariance: the same filter, with a matrix of six
        rows however many feet there are.

        Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), on the
        information filter.
        """
        stands = feet.stance & fused[:, None] & _credible(feet.position, feet.velocity)
        position, velocity = (np.where(stands[..., None], x, 0.0) for x in (feet.position, feet.velocity))
        self._H[..., 3:] = skew(position)
        turning = position @ skew((self.reading - self.bias)[:, :3])  # rows of p × ω
        residual = turning - velocity - self.velocity[:, None]
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
        white = np.where(stands[..., None], whiten(S, residual), 0.0)
        np.copyto(self.innovation, white, where=fused[:, None, None])
        nis = (white * white).sum(axis=2)
        best = np.where(stands, np.minimum(nis, NIS_MAX), NIS_MAX).min(axis=1)
        self.nis += np.where(stands.any(axis=1), (best - self.nis) / NIS_SAMPLES, 0.0)
        return np.asarray(stands & (nis <= GATE))

    def _level(self, ids: Bools, upright: Upright) -> None:
        """Tilt as it is said, which a turn φ of the error leans by φ × up; one beyond the gate is left out.

        One of the two is wrong if that goes on, and a robot that lies on its back must not take itself for one that
        stands.
        """
        leans = times(matrix(self.quat_wxyz), upright.up)
        z, S = np.stack([leans[:, 1], -leans[:, 0]], axis=1), self.P[:, :2, :2].copy()
        diagonal(S)[:] += upright.variance
        far = (z * np.linalg.solve(S, z[..., None])[..., 0]).sum(axis=1)
        diagonal(S)[:] += upright.weighed - upright.variance
        K = np.asarray(np.linalg.solve(S, self.P[:, :2]).swapaxes(1, 2), dtype=np.float64)
        used = ids & (far <= GATE) & (leans[:, 2] > 0.0)
        self.contradicted += ids & ~used
        self.contradicted[used] = 0
        self._correct(np.where(used[:, None], times(K, z), 0.0))
        self.P -= np.where(used[:, None, None], K @ self.P[:, :2], 0.0)
        self.P[:] = 0.5 * (self.P + self.P.swapaxes(1, 2))

    def _correct(self, error: Floats) -> None:
        """Put the errors (B, 12) into the belief, which leaves them 0."""
        moved = error[:, PHI].any(axis=1, keepdims=True)
        np.copyto(self.quat_wxyz, product(exp(error[:, PHI]), self.quat_wxyz), where=moved)
        self.velocity += error[:, V]
        self.bias += error[:, 6:]

    def _now(self, t: float) -> BaseState:
        lag = np.where(self.seeded, np.maximum(t - self.t_sample, 0.0), 0.0)
        age = np.where(self.seeded, t - np.minimum(self.t_sample, self.t_force), np.inf)
        motion = move(self._belief, lag, self.reading, self.reading)
        turning, velocity = (self.reading - self.bias)[:, :3], times(motion.R, motion.velocity)
        sound = np.isfinite(motion.quat_wxyz.sum(axis=1) + turning.sum(axis=1) + velocity.sum(axis=1))
        return BaseState(
            t=t,
            quat_wxyz=motion.quat_wxyz,
            angular_velocity=turning,
            velocity_in_world=velocity,
            velocity_in_base=motion.velocity,
            gravity=-motion.R[:, 2],
            age=age,
            innovation=self.innovation,
            stuck=self._stuck(),
            diverged=self.seeded & ~(sound & self._known()),
        )

    def _known(self) -> Bools:
        var = diagonal(self.P)
        tilt_var, speed_var = var[:, :2].sum(axis=1), var[:, V].max(axis=1)
        known = (tilt_var <= TILT_STD_MAX**2) & (speed_var <= SPEED_STD_MAX**2) & (self.nis <= GATE)
        return np.asarray(known & (self.contradicted < CONTRADICTED))


def _credible(*readings: Floats) -> Bools:
    """Whether all along the last axis are numbers that a sensor can give."""
    return np.asarray((np.abs(np.concatenate(readings, axis=-1)) <= RANGE).all(axis=-1))
