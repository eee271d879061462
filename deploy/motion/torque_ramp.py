"""Torques limited in rate and second rate, towards target torques."""

import numpy as np

from deploy.stage import Stage
from robots.arrays import Bools, Floats
from robots.capabilities import required
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec


class TorqueRamp(Stage):
    """Torques sent last to B robots, with their rates.

    A rate r that falls by S dt in each period, S the limit of the second rate, covers a distance d in n periods:

        d = n r dt − S dt² n (n − 1) / 2

    With the least whole n for which it can end at the target, d <= S dt² n (n + 1) / 2, r is the highest such rate.

    Attributes:
        tau: (B, n) N·m. rate: (B, n) N·m/s.
    """

    carried = ("tau", "rate")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Begin without torque; targets are clamped to `margins.tau` of the torque range."""
        self.tau, self.rate = np.zeros((2, robots, spec.n))
        self._limit, self._dt = spec.margins.of(ControlMode.TORQUE).tau * torque_max(spec), spec.dt
        modes = [required(joint.torque_mode) for joint in spec.joints]
        self._rate_max = np.array([mode.rate_max for mode in modes])
        self._rate_step = np.array([mode.rate2_max for mode in modes]) * spec.dt

    def clamped(self, target: Floats) -> Floats:
        """Return targets (B, n) N·m inside the range."""
        return np.minimum(np.maximum(target, -self._limit), self._limit)

    def next(self, target: Floats) -> tuple[Floats, Floats]:
        """Return torques and their rates one period ahead, towards targets (B, n) N·m."""
        left = self.clamped(target) - self.tau
        distance = np.abs(left)
        periods = np.ceil(0.5 * (np.sqrt(1.0 + 8.0 * distance / (self._rate_step * self._dt)) - 1.0))
        fastest = distance / (np.maximum(periods, 1.0) * self._dt) + 0.5 * self._rate_step * (periods - 1.0)
        wanted = np.sign(left) * np.minimum(fastest, self._rate_max)
        rate = np.minimum(np.maximum(wanted, self.rate - self._rate_step), self.rate + self._rate_step)
        return self.tau + rate * self._dt, rate

    def commit(self, tau: Floats, rate: Floats, followed: Bools) -> None:
        """Remember torques sent (B, n): where the ramp was `followed` (B,) with their rate, elsewhere at rest."""
        self.tau[:], self.rate[:] = tau, np.where(followed[:, None], rate, 0.0)
