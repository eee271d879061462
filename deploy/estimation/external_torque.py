"""Detection of external torque: the motor's current does not fit the commanded torque.

A blocked joint, a closed brake or a caught cable is not measured, and the joint hardly leaves its setpoint. But within
milliseconds its drive pushes against it with all of its torque.

    r = k I − τ

    r  N·m    residual          k  N·m/A  torque constant at the joint
    I  A      measured current  τ  N·m    commanded feed-forward torque

Source: Haddadin, De Luca and Albu-Schäffer, Robot Collisions: A Survey (2017), direct estimation of an external torque,
with the commanded motion in the place of the measured one.
"""

import numpy as np

from deploy.estimation.sample_count import sample_count
from deploy.stage import Stage
from deploy.state import Packet
from robots.arrays import Bools, Floats
from robots.models.nominal_model import torque_max
from robots.motors.windings import nominal_windings
from robots.spec import RobotSpec

TORQUE_SHARE = 0.5
"""Residual above which torque is external, as share of the joint's torque. Friction, other masses, payloads, cables,
pushes and worn magnets reach 0.3 for `DETECTION_S`; a block reaches 1."""
DETECTION_S = 0.06
"""s of packets in a row above the bound, after which the torque is external: a moment's ringing does not count."""


class ExternalTorque(Stage):
    """Residuals of B × n motors, compared with their bounds.

    Attributes:
        tau: (B, n) N·m, feed-forward sent last. powered: (B,) drives that were on then.
        packets: (B, n) packets in a row above the bound. t: (B,) s, when the last of them was taken.
    """

    carried = ("tau", "powered", "packets", "t")

    def __init__(self, spec: RobotSpec, robots: int, look_s: float) -> None:
        """Allocate; `look_s` is the period of `look`.

        Raises:
            RobotError: a motor's constant, or a joint's range of torque, is not in model.xml.
        """
        self.tau, self.powered = np.zeros((robots, spec.n)), np.zeros(robots, dtype=bool)
        self.packets, self.t = np.zeros((robots, spec.n), dtype=np.int64), np.full(robots, -np.inf)
        self.packets_min = sample_count(DETECTION_S, max(look_s, 1.0 / spec.sensors["current"].rate_hz))
        self._constant, self._bound = nominal_windings(spec).constant, TORQUE_SHARE * torque_max(spec)

    def reset(self, ids: Bools) -> None:
        """Forget robots `ids` (B,): their drives are off."""
        self.powered[ids], self.packets[ids] = False, 0

    def command(self, tau: Floats, powered: Bools) -> None:
        """Store what is sent: feed-forward (B, n) N·m, and drives that are on (B,)."""
        self.tau[:], self.powered[:] = tau, powered

    def look(self, current: Packet) -> Bools:
        """Return (B,) robots with an external torque, by the newest currents (B, n) A.

        A packet that was seen before and a current that is not finite leave the counts as they are.
        """
        above = np.abs(current.value * self._constant - self.tau) > self._bound
        new = (current.t != self.t)[:, None] & np.isfinite(current.value)
        self.t[:] = current.t
        self.packets += new
        self.packets *= (above | ~new) & self.powered[:, None]
        return np.asarray(self.detected.any(axis=1))

    @property
    def detected(self) -> Bools:
        """(B, n) motors with an external torque."""
        return np.asarray(self.packets >= self.packets_min)
