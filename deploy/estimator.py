"""Joint state from late, noisy, missing samples: one Kalman filter per joint, all in one pass, and heat beside it.

Each filter holds angle and speed at the time its newest sample was TAKEN, under white-noise acceleration; `State` is
that belief carried forward to now. filterpy gives the process noise and is the oracle of the tests.
"""

import numpy as np
from filterpy.common import Q_continuous_white_noise

from deploy.flags import every
from deploy.heat import Heat
from deploy.stage import Stage
from deploy.state import Bools, Floats, Sample, State
from robots.spec import RobotSpec

SPEED_STD = 1.0
"""rad/s, how unsure the speed is when a filter is seeded from one sample."""


class Estimator(Stage):
    """Angle and speed of B × n joints; `p00`, `p01` and `p11` (B, n) are their covariance; `heat` knows the motors."""

    carried = (
        *("q", "qd", "p00", "p01", "p11", "t_sample", "innovation", "seeded"),
        *(f"heat.{name}" for name in Heat.carried),
    )

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Allocate.

        Args:
            spec: encoder noise and joint restlessness.
            robots: B.
        """
        shape = (robots, spec.n)
        self.q, self.qd, self.innovation = np.zeros((3, *shape))
        self.p00, self.p01, self.p11 = np.zeros((3, *shape))
        self.t_sample = np.zeros(robots)
        self.seeded = np.zeros(robots, dtype=bool)
        self.heat, self._dt = Heat(spec, robots), spec.dt
        # numpy is quickest where every shape is the same.
        self._wide = np.zeros(shape)
        self._r = np.full(shape, spec.encoder.noise_rad**2 + spec.encoder.resolution_rad**2 / 12)
        unit = Q_continuous_white_noise(dim=2, dt=1.0, spectral_density=spec.encoder.acceleration_density)
        self._g00, self._g01, self._g11 = (np.full(shape, unit[place]) for place in ((0, 0), (0, 1), (1, 1)))

    def reset(self, ids: Bools) -> None:
        """Forget robots where `ids` (B,) holds; their next sample seeds them."""
        self.seeded[ids] = False
        self.heat.reset(ids)

    def step(self, t: float, sample: Sample) -> State:
        """Fuse what arrived and carry the belief to now.

        A packet older than the last, more than a period from the future (it would look fresh forever), or with an
        angle that is not finite is left out, as if it had never arrived.

        Args:
            t: s, now.
            sample: the newest packets.
        """
        arrived = sample.fresh & (sample.t <= t + self._dt)
        finite = np.isfinite(sample.q)
        if not every(finite):
            arrived &= finite.all(axis=1)
        if not every(self.seeded):
            self._seed(arrived & ~self.seeded & np.isfinite(sample.t), sample)
        fused = arrived & (sample.t > self.t_sample)
        dt = sample.t - self.t_sample
        dt[~fused] = 0.0
        self.t_sample += dt
        self._predict(self._each_joint(dt))
        self._update(sample.q, fused[:, None])
        self.heat.step(sample)
        return self._now(t, sample)

    def _seed(self, ids: Bools, sample: Sample) -> None:
        self.q[ids], self.qd[ids], self.innovation[ids] = sample.q[ids], 0.0, 0.0
        self.p00[ids], self.p01[ids], self.p11[ids] = self._r[ids], 0.0, SPEED_STD**2
        self.t_sample[ids], self.seeded[ids] = sample.t[ids], True

    def _each_joint(self, robots: Floats) -> Floats:
        """(B, n) of (B,), until the next call."""
        np.copyto(self._wide, robots[:, None])
        return self._wide

    def _predict(self, dt: Floats) -> None:
        self.q += self.qd * dt
        self.p00[:] = self._q_var(dt)
        self.p01 += dt * (self.p11 + self._g01 * dt)
        self.p11 += self._g11 * dt

    def _q_var(self, dt: Floats) -> Floats:
        """(B, n) rad², variance of the angle after `dt` (B, n) s without a sample."""
        return self.p00 + dt * (2.0 * self.p01 + dt * (self.p11 + self._g00 * dt))

    def _update(self, z: Floats, fused: Bools) -> None:
        """A missing sample counts as the expected one with infinite variance, which changes nothing."""
        residual, variance = z - self.q, self.p00 + self._r
        if every(fused):
            np.divide(residual, np.sqrt(variance), out=self.innovation)
        else:
            np.divide(residual, np.sqrt(variance), out=self.innovation, where=fused)
            np.copyto(residual, 0.0, where=~fused)
            np.copyto(variance, np.inf, where=~fused)
        k0, k1 = self.p00 / variance, self.p01 / variance
        self.q += k0 * residual
        self.qd += k1 * residual
        self.p11 -= k1 * self.p01
        self.p01 -= k0 * self.p01
        self.p00 -= k0 * self.p00

    def _now(self, t: float, sample: Sample) -> State:
        age = t - self.t_sample
        lag = self._each_joint(age)
        np.copyto(age, np.inf, where=~self.seeded)
        return State(
            t=t,
            q=self.q + self.qd * lag,
            qd=self.qd.copy(),
            q_var=self._q_var(lag),
            age=age,
            innovation=self.innovation,
            temperature=sample.temperature,
            winding=self.heat.winding,
        )
