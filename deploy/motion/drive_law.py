"""What torque the drives will give for a setpoint, and what they must be told for it.

There are two kinds of drives. A stiff one follows an angle, with a speed and a torque fed forward by the nominal model;
it may have the gains of a policy's training or its own. Those of a robot that walks, with the gains of training, are
springs: told an angle and nothing else, as they were there, they give

    τ = kp (q* − q) − kd q̇

and how far a joint strays from its angle is what makes its torque. What stands fixed and has a table before it is never
left to springs: its guards look where it is sent.
"""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from deploy.state import State
from robots.arrays import Floats
from robots.models.fleet import Fleet, torque_max
from robots.spec import RobotSpec


class Gains(NamedTuple):
    """Of drives: (n,) kp in N·m/rad, kd in N·m·s/rad, both at the joint."""

    kp: Floats
    kd: Floats


def same(one: Gains | None, other: Gains | None) -> bool:
    """Whether drives with `one` are drives with `other`."""
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other)


class Effort(ABC):
    """The law of B × n drives.

    Attributes:
        bound: (n,) N·m that a setpoint may ask for.
    """

    bound: Floats

    @abstractmethod
    def torque(self, state: State, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """N·m that setpoints will take, (R, n) as they are, R a whole number of times B.

        Args:
            state: what is believed of the B robots.
            q: (R, n) rad. qd: (R, n) rad/s. qdd: (R, n) rad/s², points of their trajectories.
        """

    @abstractmethod
    def poses(
        self, state: State, q: Floats, q_midst: Floats, q_rest: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """(B, n) rad each, where joints will be that are sent to `q` and on from there into a stop: now, and then.

        Args:
            state: what is believed.
            q: (B, n) rad, a setpoint. q_midst, q_rest: of the stop that begins there.
        """


class Feedforward(Effort):
    """Stiff drives: the torque of the motion itself, by the nominal model."""

    def __init__(self, spec: RobotSpec, fleet: Fleet) -> None:
        """Take the model, R robots wide; a setpoint may ask for `margins.tau` of the torque range."""
        self._fleet, self.bound = fleet, spec.margins.tau * torque_max(spec)

    def torque(self, state: State, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """By recursive Newton-Euler, as `Fleet.torque`."""
        return self._fleet.torque(q, qd, qdd)

    def poses(
        self, state: State, q: Floats, q_midst: Floats, q_rest: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Where they are sent."""
        return q, q_midst, q_rest


class Springs(Effort):
    """Drives with gains: the torque of the angle between setpoint and joint, up to what a drive has.

    An angle that asks for more is nothing to refuse: policies are trained on drives that give no more.
    """

    def __init__(self, spec: RobotSpec, gains: Gains) -> None:
        """Take the gains."""
        self._gains, self._most = gains, torque_max(spec)
        self._twice_qdd = 2.0 * spec.joint_array("qdd_max")
        self.bound = np.full(spec.n, np.inf)

    def torque(self, state: State, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """As the drives compute it, from the joints as they are believed to be now."""
        many = len(q) // len(state.q)
        stray, speed = q - np.tile(state.q, (many, 1)), np.tile(state.qd, (many, 1))
        tau = self._gains.kp * stray - self._gains.kd * speed
        return np.minimum(np.maximum(tau, -self._most), self._most)

    def poses(
        self, state: State, q: Floats, q_midst: Floats, q_rest: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Where they are, and where they come to if they brake as they may be asked to: not where they are sent.

        At half of its speed what brakes evenly has three quarters of its way behind it.
        """
        way = state.qd * np.abs(state.qd) / self._twice_qdd
        return state.q, state.q + 0.75 * way, state.q + way
