"""Brake of joints that are too fast to stop at the end of their range, where nothing predicts their load.

    τ = −J (q̇ − v) / T  where q̇ > v        v = min(s q̇_max, √(2 a (q_max − q)))

and likewise downwards. v is the speed from which the joint stops at the end of its range, evenly; beyond the end it is
sent back.

    J  kg·m²   inertia about the joint             T  s       reaction time
    a  rad/s²  share of the joint's acceleration   s  1       share of its speed limit
"""

import numpy as np

from robots.arrays import Floats
from robots.models.joint_inertia import joint_inertia
from robots.models.nominal_model import torque_max
from robots.spec import RobotSpec

REACTION_TICKS = 4
"""Control periods of T: damping with that gain bears two periods of delay and two of the estimate."""
ACCELERATION_SHARE, SPEED_SHARE = 0.25, 0.7


class JointBrake:
    """Brake of B × n joints."""

    def __init__(self, spec: RobotSpec) -> None:
        """Compute its gains."""
        self._q_min, self._q_max = spec.joint_array("q_min"), spec.joint_array("q_max")
        self._twice_qdd = 2.0 * ACCELERATION_SHARE * spec.joint_array("qdd_max")
        self._qd_max = SPEED_SHARE * spec.joint_array("qd_max")
        inertia = joint_inertia(spec)
        self._damping = np.sqrt(inertia.least * inertia.most) / (REACTION_TICKS * spec.dt)
        self._torque_max = torque_max(spec)

    def torque(self, q: Floats, qd: Floats) -> Floats:
        """Return N·m (B, n) for joints at q (B, n) rad with speeds qd (B, n) rad/s; 0 where these are not numbers."""
        up, down = self._fastest(self._q_max - q), self._fastest(q - self._q_min)
        tau = self._damping * (np.maximum(-down - qd, 0.0) - np.maximum(qd - up, 0.0))
        return self.clipped(np.where(np.isnan(tau), 0.0, tau))

    def clipped(self, tau: Floats) -> Floats:
        """Return torques (B, n) N·m inside the range of the drives."""
        return np.minimum(np.maximum(tau, -self._torque_max), self._torque_max)

    def _fastest(self, room: Floats) -> Floats:
        """Return rad/s (B, n) from which joints can stop within room (B, n) rad, negative beyond the end."""
        speed = np.copysign(np.sqrt(self._twice_qdd * np.abs(room)), room)
        return np.minimum(speed, self._qd_max)
