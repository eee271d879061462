"""Joint state from late, noisy, missing encoder samples: one Kalman filter per joint, all in one pass.

Each filter holds angle and speed at the time its newest sample was TAKEN, under white-noise acceleration; `State` is
that belief carried forward to now. filterpy gives the process noise and is the oracle of the tests.
"""

import numpy as np
from filterpy.common import Q_continuous_white_noise

from deploy.stage import Stage
from deploy.state import Bools, Floats, Sample, State
from robots.spec import RobotSpec

SPEED_STD = 1.0
"""rad/s, how unsure the speed is when a filter is seeded from one sample."""


class Estimator(Stage):
    """Angle and speed of B × n joints."""

    carried = ("q", "qd", "cov", "t_sample", "innovation", "seeded")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Allocate.

        Args:
            spec: encoder noise and joint restlessness.
            robots: B.
        """
        shape = (robots, spec.n)
        self.q, self.qd, self.innovation = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self.cov = np.zeros((robots, 3, spec.n))
        self.t_sample = np.zeros(robots)
        self.seeded = np.zeros(robots, dtype=bool)
        self._r = spec.encoder.noise_rad**2 + spec.encoder.resolution_rad**2 / 12
        self._dt, self._density = spec.dt, spec.encoder.acceleration_density
        unit = Q_continuous_white_noise(dim=2, dt=1.0, spectral_density=self._density)
        self._growth = np.array([unit[0, 0], unit[0, 1], unit[1, 1]])

    def reset(self, ids: Bools) -> None:
        """Forget robots where `ids` (B,) holds; their next sample seeds them."""
        self.seeded[ids] = False

    def step(self, t: float, sample: Sample) -> State:
        """Fuse what arrived and carry the belief to now.

        A packet older than the last, more than a period from the future (it would look fresh forever), or with an
        angle that is not finite is left out, as if it had never arrived.

        Args:
            t: s, now.
            sample: the newest packets.
        """
        whole = np.isfinite(sample.t) & np.isfinite(sample.q).all(axis=1)
        arrived = sample.fresh & whole & (sample.t <= t + self._dt)
        seed = arrived & ~self.seeded
        if seed.any():
            self._seed(seed, sample)
        use = arrived & (sample.t > self.t_sample)
        dt = np.where(use, sample.t - self.t_sample, 0.0)[:, None]
        self._predict(dt)
        self._update(sample.q, use[:, None])
        self.t_sample += dt[:, 0]
        return self._now(t, sample)

    def _seed(self, ids: Bools, sample: Sample) -> None:
        self.q[ids], self.qd[ids], self.innovation[ids] = sample.q[ids], 0.0, 0.0
        self.cov[ids] = np.array([self._r, 0.0, SPEED_STD**2])[:, None]
        self.t_sample[ids], self.seeded[ids] = sample.t[ids], True

    def _predict(self, dt: Floats) -> None:
        p00, p01, p11 = self.cov[:, 0], self.cov[:, 1], self.cov[:, 2]
        g00, g01, g11 = self._growth
        self.q += self.qd * dt
        p00 += dt * (2.0 * p01 + dt * (p11 + g00 * dt))
        p01 += dt * (p11 + g01 * dt)
        p11 += g11 * dt

    def _update(self, z: Floats, use: Bools) -> None:
        p00, p01, p11 = self.cov[:, 0], self.cov[:, 1], self.cov[:, 2]
        residual = np.where(use, z - self.q, 0.0)
        variance = p00 + self._r
        k0, k1 = use * (p00 / variance), use * (p01 / variance)
        self.q += k0 * residual
        self.qd += k1 * residual
        p11 -= k1 * p01
        p01 -= k0 * p01
        p00 -= k0 * p00
        np.copyto(self.innovation, residual / np.sqrt(variance), where=use)

    def _now(self, t: float, sample: Sample) -> State:
        age = t - self.t_sample
        lag = age[:, None]
        p00, p01, p11 = self.cov[:, 0], self.cov[:, 1], self.cov[:, 2]
        return State(
            t=t,
            q=self.q + self.qd * lag,
            qd=self.qd.copy(),
            q_var=p00 + lag * (2.0 * p01 + lag * (p11 + self._growth[0] * lag)),
            age=np.where(self.seeded, age, np.inf),
            innovation=self.innovation,
            temperature=sample.temperature,
        )
