"""Kalman filter of a joint's deviation from its setpoint; B × n independent filters.

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
filter), 5.4 (innovations) and 6.2 (white-noise acceleration).
"""

from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np
from filterpy.common import Q_continuous_white_noise

from deploy.estimation.sample_count import sample_count
from deploy.stage import Stage
from deploy.state import Packet
from robots.arrays import Bools, Floats
from robots.kernel import BOOL, FLOAT, INT, array, inlined, kernel
from robots.spec import RobotSpec

GATE = 8.0
"""Standard deviations of an innovation above which a sample is rejected: a gross error, not noise."""
INITIAL_SPEED_STD = 1.0
"""rad/s, standard deviation of the speed of a filter that was started from one sample."""
CONFIRMED_S = 0.05
"""s of accepted samples after which a filter is confirmed. Before that, a sample outside the gate restarts it."""
REFUSED_S = 0.1
"""s of samples in a row outside the gate after which a filter is restarted."""
NIS_S = 0.25
"""s of samples in the running mean of the normalized innovation squared (NIS)."""
NIS_MAX = 9.0
"""Mean NIS above which a filter has diverged; 1 is expected."""

Q_OF_UNITS = Q_continuous_white_noise(dim=2, dt=1.0, spectral_density=1.0)
"""[[1/3, 1/2], [1/2, 1]]"""

_STATE = ("e", "ed", "p00", "p01", "p11", "t_sample", "nis")
_NOISE = ("noise_dt3", "noise_dt2", "noise_dt")
_COUNTS = ("accepted", "refused")
_FIELDS = [
    *((name, np.float64) for name in (*_STATE, *_NOISE, "r")),
    *((name, np.int64) for name in _COUNTS),
]
FILTER = np.dtype((np.record, _FIELDS))
"""One filter, as `JointFilter` describes its fields; r: rad², variance of an angle packet."""


class Rules(NamedTuple):
    """Numbers that are the same for all filters.

    Attributes:
        gate: standard deviations of an innovation. r_speed: rad²/s², variance of a speed packet.
        confirmed: accepted samples after which a filter is confirmed. refused: those in a row after which it is
            restarted. nis: those in the running mean of the NIS.
    """

    gate: float
    r_speed: float
    confirmed: int
    refused: int
    nis: int


class JointFilter(Stage):
    """Filters of B × n joints; `Estimator` selects the packets.

    Attributes:
        filters: (B, n) of `FILTER`. The next five lines are views of its fields.
        e, ed: (B, n) rad and rad/s. p00, p01, p11: (B, n) their covariance.
        t_sample: (B, n) s, time of the state: when the last fused angle was taken.
        noise_dt3, noise_dt2, noise_dt: (B, n) rad²/s³, elements 00, 01 and 11 of Q over the power of dt in their names.
        nis: (B, n) running mean of the normalized innovation squared.
        accepted: (B, n) samples fused since the filter was started. refused: (B, n) samples in a row outside the gate.
        t_speed: (B,) s, when the last fused speed packet was taken.
        initialized: (B,) robots whose filters were started.
    """

    carried = (*_STATE, *_NOISE, *_COUNTS, "t_speed", "initialized")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Allocate for drives that hold their angles."""
        sensors, period_s = spec.sensors, 1.0 / spec.sensors["encoder"].rate_hz
        self.filters = np.zeros((robots, spec.n), dtype=FILTER)
        self.e, self.ed, self.p00, self.p01, self.p11, self.t_sample, self.nis = (
            self.filters[name] for name in _STATE
        )
        self.noise_dt3, self.noise_dt2, self.noise_dt = (self.filters[name] for name in _NOISE)
        self.accepted, self.refused = (self.filters[name] for name in _COUNTS)
        self.t_speed, self.initialized = np.full(robots, -np.inf), np.zeros(robots, dtype=bool)
        self.filters["r"] = sensors["encoder"].variance
        counts = (sample_count(s, period_s) for s in (CONFIRMED_S, REFUSED_S, NIS_S))
        r_speed = sensors["velocity"].variance if "velocity" in sensors else np.inf
        self.rules = Rules(GATE, float(r_speed), *counts)
        self._density_held = spec.joint_array("acceleration_density")
        modes = [joint.torque_mode for joint in spec.joints]  # joints without one are never free
        self._density_free = np.array([mode.acceleration_density if mode else np.inf for mode in modes])
        self.follow_drives(np.zeros((robots, spec.n), dtype=bool))

    def follow_drives(self, free: Bools) -> None:
        """Take the process noise of drives that do not hold their angles at joints `free` (B, n), held elsewhere."""
        density = np.where(free, self._density_free, self._density_held)
        (q00, q01), (_, q11) = Q_OF_UNITS
        np.multiply(density, q00, out=self.noise_dt3)
        np.multiply(density, q01, out=self.noise_dt2)
        np.multiply(density, q11, out=self.noise_dt)

    def widen(self, p00: Floats, p11: Floats) -> None:
        """Add p00 (B, n) rad² and p11 (B, n) rad²/s² to the variances: motion that the process noise does not cover."""
        self.p00 += p00
        self.p11 += p11

    def fuse(self, packet: Packet, usable: Bools, origin: Floats) -> Bools:
        """Fuse a packet of angles of each robot where it is `usable` (B,); return (B, n) samples inside the gate.

        Ignored are angles that are not finite or not newer than the last. Deviations are measured from `origin` (B, n)
        rad. The first packet whose angles are all finite starts a robot's filters.
        """
        fused = np.empty(self.filters.shape, dtype=bool)
        _fuse(self.filters, self.initialized, packet.t, usable, packet.value, origin, self.rules, fused)
        return fused

    def fuse_speeds(self, packet: Packet, usable: Bools, origin: Floats) -> None:
        """Correct robots `usable` (B,) by their packet of speeds; rates are measured from `origin` (B, n) rad/s."""
        robots = self.filters, self.initialized, self.t_speed
        _fuse_speeds(*robots, packet.t, usable, packet.value, origin, self.rules)

    def predict(self, t: float, q: Floats, qd: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return angles, speeds and the angles' variances (B, n) at `t` s, and the age (B,) s of the oldest sample.

        Args:
            t: now. q, qd: (B, n) rad, rad/s, from which deviations are measured.

        The age of a robot is infinite until all of its filters are confirmed.
        """
        joints, age = np.empty((3, *self.filters.shape)), np.empty(len(self.filters))
        _predict(self.filters, self.rules.confirmed, t, q, qd, joints, age)
        return joints[0], joints[1], joints[2], age

    @property
    def confirmed(self) -> Bools:
        """(B, n) filters with enough accepted samples to be used."""
        return np.asarray(self.accepted >= self.rules.confirmed)

    @property
    def diverged(self) -> Bools:
        """(B, n) filters whose mean NIS is above its limit or whose covariance is not finite."""
        return np.asarray(~((self.nis <= NIS_MAX) & np.isfinite(self.p00 + self.p11)))


@inlined
def _start(f: Any, t: float, z: float) -> None:
    """Start a filter from one sample z rad, taken at t s: x = [z, 0],  P = diag(r, INITIAL_SPEED_STD²)."""
    f.e, f.ed, f.t_sample = z, 0.0, t
    f.p00, f.p01, f.p11 = f.r, 0.0, INITIAL_SPEED_STD**2
    f.accepted, f.refused = 1, 0


@inlined
def _angle_variance(f: Any, dt: float) -> float:
    """Return element 00 of F P Fᵀ + Q, rad²: p00 + 2 dt p01 + dt² p11 + q dt³/3."""
    return f.p00 + dt * (2.0 * f.p01 + dt * (f.p11 + f.noise_dt3 * dt))  # type: ignore[no-any-return]


@inlined
def _correct(f: Any, t: float, z: float, rules: Rules) -> bool:
    """Correct a filter by a sample z rad, taken at t s; return False if it was outside the gate.

    x⁻ = F x,  P⁻ = F P Fᵀ + Q,  y = z − H x⁻,  S = H P⁻ Hᵀ + r,  K = P⁻ Hᵀ/S,  x = x⁻ + K y,  P = (I − K H) P⁻
    """
    dt = t - f.t_sample
    e, p00 = f.e + f.ed * dt, _angle_variance(f, dt)
    y, s = z - e, p00 + f.r
    nis = y * y / s
    f.nis += (min(nis, rules.gate**2) - f.nis) / rules.nis
    if not nis <= rules.gate**2:
        f.refused += 1
        if f.accepted < rules.confirmed or f.refused >= rules.refused:
            _start(f, t, z)
        return False
    p01, p11 = f.p01 + dt * (f.p11 + f.noise_dt2 * dt), f.p11 + f.noise_dt * dt
    k0, k1 = p00 / s, p01 / s
    f.e, f.ed, f.t_sample = e + k0 * y, f.ed + k1 * y, t
    f.p00, f.p01, f.p11 = p00 - k0 * p00, p01 - k0 * p01, p11 - k1 * p01
    f.accepted += 1
    f.refused = 0
    return True


_FILTERS, _ROBOTS, _JOINTS = array(FILTER, 2, written=True), array(FLOAT, 1), array(FLOAT, 2)
_FLAGS, _INITIALIZED = array(BOOL, 1), array(BOOL, 1, written=True)
_RULES = Rules(0.0, 0.0, 0, 0, 0)
_PACKET = _ROBOTS, _FLAGS, _JOINTS, _JOINTS  # t, usable, value, origin


@kernel(_FILTERS, _INITIALIZED, *_PACKET, _RULES, array(BOOL, 2, written=True))
def _fuse(
    filters: Any,
    initialized: Bools,
    t: Floats,
    usable: Bools,
    angle: Floats,
    origin: Floats,
    rules: Rules,
    fused: Bools,
) -> None:
    robots, n = filters.shape
    for robot in range(robots):
        follows, starts = usable[robot] and initialized[robot], usable[robot] and not initialized[robot]
        for joint in range(n):
            starts = starts and isfinite(angle[robot, joint])
        for joint in range(n):
            f, z = filters[robot, joint], angle[robot, joint] - origin[robot, joint]
            fused[robot, joint] = False
            if starts:
                _start(f, t[robot], z)
                f.nis = 1.0
            elif follows and t[robot] > f.t_sample and isfinite(angle[robot, joint]):
                fused[robot, joint] = _correct(f, t[robot], z, rules)
        initialized[robot] = initialized[robot] or starts


@kernel(_FILTERS, _FLAGS, array(FLOAT, 1, written=True), *_PACKET, _RULES)
def _fuse_speeds(
    filters: Any,
    initialized: Bools,
    t_speed: Floats,
    t: Floats,
    usable: Bools,
    speed: Floats,
    origin: Floats,
    rules: Rules,
) -> None:
    """Correct by y = z − H x with S = H P Hᵀ + r_speed + q |t − t_sample|: the two samples are not of one time."""
    robots, n = filters.shape
    for robot in range(robots):
        if not (usable[robot] and initialized[robot] and t[robot] > t_speed[robot]):
            continue
        t_speed[robot] = t[robot]
        for joint in range(n):
            f = filters[robot, joint]
            y = speed[robot, joint] - origin[robot, joint] - f.ed
            s = f.p11 + rules.r_speed + f.noise_dt * abs(t[robot] - f.t_sample)
            if y * y <= rules.gate**2 * s:
                k0, k1 = f.p01 / s, f.p11 / s
                f.e, f.ed = f.e + k0 * y, f.ed + k1 * y
                f.p00, f.p01, f.p11 = f.p00 - k0 * f.p01, f.p01 - k0 * f.p11, f.p11 - k1 * f.p11


@kernel(
    *(_FILTERS, INT, FLOAT, _JOINTS, _JOINTS),
    *(array(FLOAT, 3, written=True), array(FLOAT, 1, written=True)),
)
def _predict(
    filters: Any,
    confirmed: int,
    now: float,
    q: Floats,
    qd: Floats,
    predicted: Floats,
    age: Floats,
) -> None:
    robots, n = filters.shape
    for robot in range(robots):
        age[robot] = -inf
        for joint in range(n):
            f = filters[robot, joint]
            dt = now - f.t_sample
            age[robot] = max(age[robot], dt if f.accepted >= confirmed else inf)
            predicted[0, robot, joint] = q[robot, joint] + (f.e + f.ed * dt)
            predicted[1, robot, joint] = qd[robot, joint] + f.ed
            predicted[2, robot, joint] = _angle_variance(f, dt)
