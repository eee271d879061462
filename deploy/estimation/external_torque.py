"""Whether motors work against something: what their current says of torque, against what their motion needs.

A joint that is blocked, brakes that close, a cable that is caught: nobody measures them, and the joint hardly strays,
but within milliseconds its drive leans against them with all that it has.

    r = k I − τ

Source: Haddadin, De Luca and Albu-Schäffer, Robot Collisions: A Survey (2017), direct estimation of an external torque,
with the motion that was sent in the place of the measured one.
"""

import numpy as np

from deploy.stage import Stage
from deploy.state import Packet
from robots.arrays import Bools, Floats
from robots.models.fleet import torque_max
from robots.spec import RobotSpec
from robots.windings import nominal_windings

SHARE = 0.5
"""Of a joint's torque, that its motor may give more or less than its motion needs by the nominal model. Friction,
other masses, payloads, cables, pushes and worn magnets come to 0.3 for so long as `LOOKS` are apart; a block to 1."""
LOOKS = 3
"""Packets in a row in which a motor must have been beyond that: less than a moment's ringing does not count."""


class Load(Stage):
    """What B × n motors do beside what they were asked to.

    Attributes:
        tau: (B, n) N·m, feed-forward that was sent last. powered: (B,) whether the drives were on then.
        many: (B, n) packets in a row that were beyond the bound. t: (B,) s, when the last of them was taken.
    """

    carried = ("tau", "powered", "many", "t")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Nothing was sent yet.

        Raises:
            RobotError: a motor's constant, or a joint's range of torque, is not in model.xml.
        """
        self.tau, self.powered = np.zeros((robots, spec.n)), np.zeros(robots, dtype=bool)
        self.many, self.t = np.zeros((robots, spec.n), dtype=np.int64), np.full(robots, -np.inf)
        self._constant, self._bound = nominal_windings(spec).constant, SHARE * torque_max(spec)

    def reset(self, ids: Bools) -> None:
        """Robots where `ids` (B,) holds have been asked for nothing."""
        self.powered[ids], self.many[ids] = False, 0

    def ask(self, tau: Floats, powered: Bools) -> None:
        """Remember what is sent: feed-forward (B, n) N·m, and whether drives are on (B,)."""
        self.tau[:], self.powered[:] = tau, powered

    def look(self, current: Packet) -> Bools:
        """(B,) whether a motor works against something, by the newest currents (B, n) A.

        A packet that is looked at again, and a current that is no number, say nothing and take nothing back.
        """
        beyond = np.abs(current.value * self._constant - self.tau) > self._bound
        said = (current.t != self.t)[:, None] & np.isfinite(current.value)
        self.t[:] = current.t
        self.many += said
        self.many *= (beyond | ~said) & self.powered[:, None]
        return np.asarray(self.against.any(axis=1))

    @property
    def against(self) -> Bools:
        """(B, n) motors that work against something."""
        return np.asarray(self.many >= LOOKS)
