"""Error-state Kalman filter of a floating base: orientation and velocity from its IMU and its standing feet.

The nominal state is orientation R, velocity v in the base frame, and the biases of gyro and accelerometer, at the time
when the newest gyro sample was taken. `base_model` has its twelve errors and their transition by the IMU (F, Q).

    measurement       innovation y                 H, columns φ  δv  δb_g  δb_a     noise
    standing foot     −(v + ω × p + ṗ)             [ 0    I   [p]×  0 ]             slip² / dt, (m/s)²
    up by the IMU     (l_y, −l_x),  l = R up       [ I₂0  0   0     0 ]             variance, rad²

p, ṗ: m, m/s, a foot relative to the base; ω: gyro without bias. A standing foot does not move in the world, except for
slip. I₂0: the first two rows of I₃.

With v in the base frame and φ in the world frame, H of a foot is linear in the errors and 0 for φ, and gravity does not
show a turn about itself: yaw is unobservable in the equations as in the world.

Source: Bloesch et al., State estimation for legged robots: consistent fusion of leg kinematics and IMU (2012); Solà,
Quaternion kinematics for the error-state Kalman filter (2017), sections 5 to 7, for the errors in continuous and
discrete time. filterpy is the oracle of the tests.
"""

import numpy as np

from deploy.estimation.floating_base.base_faults import GATE, BaseDivergence, ImuCheck, in_range
from deploy.estimation.floating_base.base_measurements import BaseNoise, Feet, Imu, Upright
from deploy.estimation.floating_base.base_model import (
    ACC,
    PHI,
    G,
    NominalState,
    V,
    diagonal,
    error_transition,
    move,
    whiten,
)
from deploy.masks import any_true
from deploy.stage import Stage
from deploy.state import BaseState
from robots.arrays import Bools, Floats
from robots.rotations import exp, from_up, matrix, matvec, norm, product, skew

REST_BAND = (0.8, 1.2)
"""Specific force of a robot at rest, as share of G: a filter is initialized from no other sample."""
INITIAL_ACCELERATION_STD, INITIAL_SPEED_STD = 0.3, 0.5
"""m/s², m/s: standard deviations of a robot's motion when its filter is initialized."""
OBSERVED = slice(3, 9)
"""Errors in H of a foot: δv and δb_g."""


class BaseFilter(Stage):
    """Filters of B bases with F feet.

    Attributes:
        quat_wxyz: (B, 4). velocity: (B, 3) m/s in the base frame. bias: (B, 6) of gyro and accelerometer.
        P: (B, 12, 12) covariance of their errors.
        reading: (B, 6) last fused gyro and accelerometer. t_sample: (B,) s, when the gyro's was taken.
        t_accelerometer: (B,) s, when the newest of the accelerometer was taken.
        initialized: (B,). innovation: (B, F, 3) of the feet, whitened.
        height: (B,) m, of the IMU above the lowest foot when feet were evaluated last; infinite before.
    """

    carried = (
        *("quat_wxyz", "velocity", "bias", "P", "reading", "t_sample", "t_accelerometer"),
        *("initialized", "innovation", "height"),
    )
    parts = ("imu_check", "divergence")

    def __init__(
        self,
        noise: BaseNoise,
        dt: float,
        robots: int,
        feet: int,
        *,
        look_s: float | None = None,
        tilt_s: float | None = None,
    ) -> None:
        """Allocate; periods in s: dt of the IMU's samples, look_s of feet, tilt_s of up (None: as feet)."""
        self.quat_wxyz, self.velocity = np.tile([1.0, 0.0, 0.0, 0.0], (robots, 1)), np.zeros((robots, 3))
        self.bias, self.reading = np.zeros((2, robots, 6))
        self.P, self.innovation = np.zeros((robots, 12, 12)), np.zeros((robots, feet, 3))
        self.t_sample, self.t_accelerometer = np.zeros((2, robots))
        self.initialized, self.height = np.zeros(robots, dtype=bool), np.full(robots, np.inf)
        self.imu_check = ImuCheck(dt, robots)
        self.divergence = BaseDivergence(robots, look_s or dt, tilt_s or look_s or dt)
        self._noise, self._dt = noise, dt
        self._nominal = NominalState(self.quat_wxyz, self.velocity, self.bias)
        self._walk = np.repeat([noise.gyro_walk**2, noise.accelerometer_walk**2], 3)
        self._foot_var = noise.slip**2 / dt
        self._H = np.tile(np.eye(3, 6), (robots, feet, 1, 1))  # of each foot: columns δv, δb_g

    def reset(self, ids: Bools) -> None:
        """Forget robots `ids` (B,); their next sample at rest initializes them."""
        self.initialized[ids], self.height[ids] = False, np.inf

    @np.errstate(all="ignore")  # numbers that overflow are found by `divergence`
    def step(self, t: float, imu: Imu, feet: Feet | None, upright: Upright | None = None) -> BaseState:
        """Fuse what arrived and predict to now.

        Ignored are packets that are older than the last, more than a period from the future, or out of range. If only
        the gyro's sample is new, it is fused with the accelerometer's last one.

        Args:
            t: s, now. imu: the newest packets.
            feet: at the times of these packets; None: not evaluated in this tick.
            upright: of an IMU that estimates its own orientation.
        """
        reading = np.concatenate([imu.gyro, imu.accelerometer], axis=1)
        valid = np.isfinite(imu.t) & np.isfinite(imu.t_accelerometer)
        valid &= np.maximum(imu.t, imu.t_accelerometer) <= t + self._dt
        valid &= imu.fresh & in_range(reading)
        newer = valid & self.initialized & (imu.t > self.t_sample)
        begins = valid & ~self.initialized
        if any_true(begins):
            self._initialize(begins, imu, reading)
        new_force = newer & (imu.t_accelerometer > self.t_accelerometer)
        self.imu_check.step(np.stack([newer, new_force], axis=1), reading, self.reading)
        np.copyto(self.t_accelerometer, imu.t_accelerometer, where=new_force)
        fused = newer & ~self.imu_check.stuck
        self._predict(fused, imu.t, reading)
        if feet is not None:
            self._correct_by_feet(fused, feet)
            np.copyto(self.height, self._above(feet), where=fused | (begins & self.initialized))
        if upright is not None:
            self._correct_by_up(upright.fresh & self.initialized, upright)
        return self._state(t)

    def _initialize(self, ids: Bools, imu: Imu, reading: Floats) -> None:
        """Start robots `ids` (B,) that are at rest, with the tilt that the accelerometer measures."""
        force = norm(reading[:, 3:])[:, 0]
        ids = ids & (force >= REST_BAND[0] * G) & (force <= REST_BAND[1] * G)
        quat_wxyz = from_up(reading[ids, 3:])
        self.P[ids], self.quat_wxyz[ids] = self._initial_covariance(quat_wxyz), quat_wxyz
        self.velocity[ids], self.bias[ids], self.reading[ids] = 0.0, 0.0, reading[ids]
        self.innovation[ids], self.imu_check.repeats[ids], self.initialized[ids] = 0.0, 0, True
        self.t_sample[ids], self.t_accelerometer[ids] = imu.t[ids], imu.t_accelerometer[ids]
        self.divergence.reset(ids)

    def _initial_covariance(self, quat_wxyz: Floats) -> Floats:
        """Return P (N, 12, 12) of robots at rest: their tilt has the error of the accelerometer's bias."""
        noise, bias_var = self._noise, self._noise.accelerometer_bias**2
        tilt_var = (bias_var + INITIAL_ACCELERATION_STD**2) / G**2
        P = np.zeros((len(quat_wxyz), 12, 12))
        diagonal(P)[:] = np.repeat([tilt_var, INITIAL_SPEED_STD**2, noise.gyro_bias**2, bias_var], 3)
        P[:, 2, 2] = 0.0  # yaw is counted from here
        tilt_by_bias = skew(np.array([0.0, 0.0, bias_var / G])) @ matrix(quat_wxyz)
        P[:, PHI, ACC], P[:, ACC, PHI] = tilt_by_bias, tilt_by_bias.swapaxes(1, 2)
        return P

    def _predict(self, fused: Bools, t: Floats, reading: Floats) -> None:
        """Predict to t (B,) s where `fused` (B,): x = move(x), P = F P Fᵀ + Q, by blocks, for the biases' F is I."""
        rows = fused[:, None]
        dt, reading = np.where(fused, t - self.t_sample, 0.0), np.where(rows, reading, self.reading)
        unseen = np.maximum(dt - self._dt, 0.0) ** 3 / 12  # a bridge between two measured ends
        motion = move(self._nominal, dt, self.reading, reading)
        F, Q = error_transition(motion, self._noise, dt, unseen)
        FP, P = F @ self.P, self.P
        P[:, :6, 6:] = FP[:, :, 6:]
        P[:, 6:, :6] = FP[:, :, 6:].swapaxes(1, 2)
        P[:, :6, :6] = FP @ F.swapaxes(1, 2) + Q
        diagonal(P[:, 6:, 6:])[:] += self._walk * dt[:, None]
        np.copyto(self.quat_wxyz, motion.quat_wxyz, where=rows)
        self.velocity[:], self.reading[:] = motion.velocity, reading
        self.t_sample += dt

    def _above(self, feet: Feet) -> Floats:
        """Return (B,) m that the IMU is above the lowest foot; a foot at no known place counts as level with it."""
        below = -np.matvec(feet.position, matrix(self.quat_wxyz)[:, 2])
        return np.asarray(np.where(in_range(feet.position), below, 0.0).max(axis=1))

    def _correct_by_feet(self, fused: Bools, feet: Feet) -> None:
        """Correct by all feet at once; a foot that does not stand or is outside the gate has no weight.

        Information form, with a matrix of six rows (O: the errors in H) however many feet there are:

            Λ = Σ Hᵀ R⁻¹ H,  λ = Σ Hᵀ R⁻¹ y,  A = P_·O (I + Λ P_OO)⁻¹,  x += A λ,  P −= A Λ P_O·

        Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), on the
        information filter.
        """
        stands = feet.stance & fused[:, None] & in_range(feet.position, feet.velocity)
        position, velocity = (np.where(stands[..., None], x, 0.0) for x in (feet.position, feet.velocity))
        self._H[..., 3:] = skew(position)
        turning = position @ skew((self.reading - self.bias)[:, :3])  # rows of p × ω
        residual = turning - velocity - self.velocity[:, None]
        used = self._gate(fused, stands, residual)
        robots, n = stands.shape
        H, y = self._H.reshape(robots, 3 * n, 6), residual.reshape(robots, 3 * n, 1)
        weighted = (self._H * (used / self._foot_var)[..., None, None]).reshape(H.shape).swapaxes(1, 2)
        information = np.concatenate([weighted @ H, weighted @ y], axis=2)  # Λ, λ
        P_O = self.P[:, :, OBSERVED]
        change = P_O @ np.linalg.solve(np.eye(6) + information[..., :6] @ P_O[:, OBSERVED], information)
        self._apply(change[..., 6])
        self.P -= change[..., :6] @ P_O.swapaxes(1, 2)
        self.P[:] = 0.5 * (self.P + self.P.swapaxes(1, 2))

    def _gate(self, fused: Bools, stands: Bools, residual: Floats) -> Bools:
        """Return the feet (B, F) that are inside the gate: yᵀ S⁻¹ y <= GATE,  S = H P Hᵀ + R."""
        H = self._H
        HP = (H.reshape(len(H), -1, 6) @ self.P[:, OBSERVED, OBSERVED]).reshape(H.shape)
        S = HP @ H.swapaxes(2, 3) + self._foot_var * np.eye(3)
        white = np.where(stands[..., None], whiten(S, residual), 0.0)
        np.copyto(self.innovation, white, where=fused[:, None, None])
        nis = (white * white).sum(axis=2)
        self.divergence.add_feet(nis, stands)
        return np.asarray(stands & (nis <= GATE))

    def _correct_by_up(self, ids: Bools, upright: Upright) -> None:
        """Correct the tilt of robots `ids` (B,) where up is inside the gate: K = P Hᵀ S⁻¹,  x += K y,  P −= K H P.

        A robot that lies on its back must not be estimated to stand: up must not be below the base.
        """
        up = matvec(matrix(self.quat_wxyz), upright.up)
        y, S = np.stack([up[:, 1], -up[:, 0]], axis=1), self.P[:, :2, :2].copy()
        diagonal(S)[:] += upright.variance
        nis = (y * np.linalg.solve(S, y[..., None])[..., 0]).sum(axis=1)
        diagonal(S)[:] += upright.correlated_variance - upright.variance
        K = np.asarray(np.linalg.solve(S, self.P[:, :2]).swapaxes(1, 2), dtype=np.float64)
        used = ids & (nis <= GATE) & (up[:, 2] > 0.0)
        self.divergence.add_tilt(ids, used)
        self._apply(np.where(used[:, None], matvec(K, y), 0.0))
        self.P -= np.where(used[:, None, None], K @ self.P[:, :2], 0.0)
        self.P[:] = 0.5 * (self.P + self.P.swapaxes(1, 2))

    def _apply(self, error: Floats) -> None:
        """Add the errors (B, 12) to the nominal state; they are 0 afterwards."""
        turned = error[:, PHI].any(axis=1, keepdims=True)
        np.copyto(self.quat_wxyz, product(exp(error[:, PHI]), self.quat_wxyz), where=turned)
        self.velocity += error[:, V]
        self.bias += error[:, 6:]

    def _state(self, t: float) -> BaseState:
        lag = np.where(self.initialized, np.maximum(t - self.t_sample, 0.0), 0.0)
        age = np.where(self.initialized, t - np.minimum(self.t_sample, self.t_accelerometer), np.inf)
        motion = move(self._nominal, lag, self.reading, self.reading)
        turning, velocity = (self.reading - self.bias)[:, :3], matvec(motion.R, motion.velocity)
        finite = np.isfinite(motion.quat_wxyz.sum(axis=1) + turning.sum(axis=1) + velocity.sum(axis=1))
        return BaseState(
            t=t,
            quat_wxyz=motion.quat_wxyz,
            angular_velocity=turning,
            velocity_in_world=velocity,
            velocity_in_base=motion.velocity,
            gravity=-motion.R[:, 2],
            height=self.height,
            age=age,
            innovation=self.innovation,
            stuck=self.imu_check.stuck,
            diverged=self.initialized & ~(finite & self.divergence.consistent(self.P)),
        )
