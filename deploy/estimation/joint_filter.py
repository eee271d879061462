"""Kalman filter of a joint's deviation from its setpoint; B × n independent filters in one pass.

    state             x = [e, ed]          rad, rad/s: deviation from the setpoint and its rate, at t_sample
    covariance        P = [p00  p01]       rad², rad²/s
                          [p01  p11]       rad²/s, rad²/s²
    motion            d(ed)/dt = w         w: white noise of spectral density q, rad²/s³ (acceleration_density)
    transition        F = [1  dt]          dt: s, from t_sample to the time at which a packet was taken
                          [0   1]
    process noise     Q = q [dt³/3  dt²/2]
                            [dt²/2  dt   ]
    angle packet      z = H x + v,  H = [1  0],  variance of v: r, rad²
    speed packet      z = H x + v,  H = [0  1],  variance of v: r_speed, rad²/s²

A deviation changes far less than an angle, so that q can be small. A joint on a soft drive does not follow its
setpoint: its deviation is measured from an angle of 0. filterpy gives the process noise and is the oracle of the tests.

Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), sec. 5.2 (Kalman
filter) and 6.2 (white-noise acceleration).
"""

from typing import NamedTuple

import numpy as np
from filterpy.common import Q_continuous_white_noise

from deploy.masks import all_true
from deploy.stage import Stage
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec

GATE = 8.0
"""Standard deviations of an innovation above which a sample is rejected: a gross error, not noise."""
INITIAL_SPEED_STD = 1.0
"""rad/s, standard deviation of the speed of a filter that was started from one sample."""

Q_OF_UNITS = Q_continuous_white_noise(dim=2, dt=1.0, spectral_density=1.0)
"""[[1/3, 1/2], [1/2, 1]]"""


class Prediction(NamedTuple):
    """Prediction to a packet's time, compared with the packet; every array (B, n).

    Attributes:
        dt: s, time predicted over.
        e: rad. p00: rad². Predicted deviation and its variance.
        y: rad, innovation. s: rad², its variance. nis: y²/s, normalized innovation squared.
    """

    dt: Floats
    e: Floats
    p00: Floats
    y: Floats
    s: Floats
    nis: Floats


class JointFilter(Stage):
    """The Kalman equations; `Estimator` selects packets, `Divergence` decides on confirmation and restarts.

    Attributes:
        e, ed: (B, n) rad and rad/s. p00, p01, p11: (B, n) their covariance.
        t_sample: (B, n) s, time of the state: when the last fused angle was taken.
        t_speed: (B,) s, when the last fused speed packet was taken.
        initialized: (B,) robots whose filters were started.
        noise_dt3, noise_dt2, noise_dt: (B, n) rad²/s³, elements 00, 01 and 11 of Q over the power of dt in their names.
        gate: innovation gate, in standard deviations.
    """

    carried = (
        *("e", "ed", "p00", "p01", "p11", "t_sample", "t_speed", "initialized"),
        *("noise_dt3", "noise_dt2", "noise_dt"),
    )

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Allocate for drives that hold their angles."""
        shape, sensors = (robots, spec.n), spec.sensors
        self.e, self.ed, self.p00, self.p01, self.p11, self.t_sample = np.zeros((6, *shape))
        self.t_speed, self.initialized = np.full(robots, -np.inf), np.zeros(robots, dtype=bool)
        self.gate = GATE
        # numpy is fastest where all shapes are equal.
        self._joint_buffer, self._r = np.zeros(shape), np.full(shape, sensors["encoder"].variance)
        self._r_speed = sensors["velocity"].variance if "velocity" in sensors else np.inf
        self._density_held = spec.joint_array("acceleration_density")
        modes = [joint.torque_mode for joint in spec.joints]  # joints without one are never free
        self._density_free = np.array([mode.acceleration_density if mode else np.inf for mode in modes])
        self.noise_dt3, self.noise_dt2, self.noise_dt = np.empty((3, *shape))
        self.follow_drives(np.zeros(shape, dtype=bool))

    def follow_drives(self, free: Bools) -> None:
        """Take the process noise of drives that do not hold their angles at joints `free` (B, n), held elsewhere."""
        density = np.where(free, self._density_free, self._density_held)
        (q00, q01), (_, q11) = Q_OF_UNITS
        np.multiply(density, q00, out=self.noise_dt3)
        np.multiply(density, q01, out=self.noise_dt2)
        np.multiply(density, q11, out=self.noise_dt)

    def initialize(self, joints: Bools, t: Floats, z: Floats) -> None:
        """Start the filters of `joints` (B, n) from samples z (B, n) rad taken at t (B,) s, with a rate of 0.

        x = [z, 0],  P = diag(r, INITIAL_SPEED_STD²)
        """
        self.e[joints], self.ed[joints] = z[joints], 0.0
        self.p00[joints], self.p01[joints], self.p11[joints] = self._r[joints], 0.0, INITIAL_SPEED_STD**2
        np.copyto(self.t_sample, t[:, None], where=joints)

    def angle_variance(self, dt: Floats) -> Floats:
        """Return element 00 of F P Fᵀ + Q, (B, n) rad², after dt (B, n) s.

        p00 + 2 dt p01 + dt² p11 + q dt³/3
        """
        variance: Floats = self.p00 + dt * (2.0 * self.p01 + dt * (self.p11 + self.noise_dt3 * dt))
        return variance

    def widen(self, p00: Floats, p11: Floats) -> None:
        """Add p00 (B, n) rad² and p11 (B, n) rad²/s² to the variances: motion that the process noise does not cover."""
        self.p00 += p00
        self.p11 += p11

    def predict(self, t: Floats, z: Floats, new: Bools) -> Prediction:
        """Predict to the packets' times and compare.

        x⁻ = F x,  P⁻ = F P Fᵀ + Q,  y = z − H x⁻,  S = H P⁻ Hᵀ + r

        Packets were taken at t (B,) s, with deviations z (B, n) rad; those that are not `new` (B, n) are predicted
        over 0 s.
        """
        dt = self._per_joint(t) - self.t_sample
        if not all_true(new):
            dt[~new] = 0.0
        e, p00 = self.e + self.ed * dt, self.angle_variance(dt)
        y, s = z - e, p00 + self._r
        return Prediction(dt, e, p00, y, s, y * y / s)

    def inside_gate(self, predicted: Prediction) -> Bools:
        """Return (B, n) samples with y² <= gate² S."""
        inside: Bools = predicted.nis <= self.gate**2
        return inside

    def correct(self, t: Floats, predicted: Prediction, fused: Bools) -> None:
        """Correct where `fused` (B, n), by packets taken at t (B,) s: K = P⁻ Hᵀ/S, x = x⁻ + K y, P = (I − K H) P⁻."""
        dt, e, p00, y, s, _ = predicted
        if not all_true(fused):  # predicted over 0 s and corrected by a sample of infinite variance
            missing = ~fused
            e[missing], p00[missing] = self.e[missing], self.p00[missing]
            dt[missing], y[missing], s[missing] = 0.0, 0.0, np.inf
        np.copyto(self.t_sample, t[:, None], where=fused)
        p01, p11 = self.p01 + dt * (self.p11 + self.noise_dt2 * dt), self.p11 + self.noise_dt * dt
        k0, k1 = p00 / s, p01 / s
        np.add(e, k0 * y, out=self.e)
        self.ed += k1 * y
        np.subtract(p00, k0 * p00, out=self.p00)
        np.subtract(p01, k0 * p01, out=self.p01)
        np.subtract(p11, k1 * p01, out=self.p11)

    def correct_by_speed(self, t: Floats, z: Floats, new: Bools) -> None:
        """Correct robots `new` (B,) by rates z (B, n) rad/s measured at t (B,) s, where they are inside the gate."""
        # y = z − H x, S = H P Hᵀ + r_speed + q |t − t_sample|: process noise for the time between the two samples
        y, dt = z - self.ed, np.abs(self._per_joint(t) - self.t_sample)
        s = self.p11 + self._r_speed + self.noise_dt * dt
        fused = new[:, None] & (y * y <= self.gate**2 * s)
        np.copyto(self.t_speed, t, where=new)
        np.copyto(y, 0.0, where=~fused)
        np.copyto(s, np.inf, where=~fused)
        k0, k1 = self.p01 / s, self.p11 / s
        self.e += k0 * y
        self.ed += k1 * y
        self.p00 -= k0 * self.p01
        self.p01 -= k0 * self.p11
        self.p11 -= k1 * self.p11

    def _per_joint(self, robots: Floats) -> Floats:
        """Return (B,) values as (B, n) in a buffer that the next call overwrites."""
        np.copyto(self._joint_buffer, robots[:, None])
        return self._joint_buffer
