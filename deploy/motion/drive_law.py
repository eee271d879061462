"""Drive laws: the torque that drives will give for a setpoint, and the poses where joints are expected.

`StiffDrives` follow an angle, with a speed and a torque fed forward by the nominal model; their gains may be those of
a policy's training or their own. `SpringDrives` are those of a robot with a floating base that keep the gains of
training: they receive an angle and nothing else, as in training, and give

    τ = kp (q* − q) − kd q̇

so that the distance of a joint from its angle makes its torque. `CompliantDrives` are those of such a robot with gains
of their own. A fixed robot has neither: its checks look where it is sent, not where it is.
"""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from deploy.state import BRAKING_SHARES, STOP_MOMENTS, State
from robots.arrays import Floats
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from robots.motors.gains import Gains
from robots.spec import RobotSpec

DISTANCE_BRAKED = 1.0 - (1.0 - np.array((0.0, *BRAKING_SHARES, 1.0))[:, None, None]) ** 2
"""Share of its way behind an evenly braking joint: at the setpoint, at the moments of its stop, and at its end."""


class DriveLaw(ABC):
    """Law of B × n drives.

    Attributes:
        torque_limit: (n,) N·m that a setpoint may need.
        current_share: largest share of their range that drives may give.
        expectations: K, number of poses where joints may be expected at any moment.
    """

    torque_limit: Floats
    current_share: float = 1.0
    expectations: ClassVar[int] = 1

    @abstractmethod
    def torque(self, state: State, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Return (PB, n) N·m that points q, qd, qdd (PB, n) need: setpoints and their stops, P = STOP_MOMENTS + 2."""

    def limited(self, tau: Floats) -> Floats:
        """Return the torques (B, n) N·m that are sent for those of setpoints; a stop may need more than was checked."""
        return tau

    @abstractmethod
    def expected_poses(self, state: State, sent: Floats) -> Floats:
        """Return (PKB, n) rad: joints expected at B setpoints, while their stops brake, and at their ends.

        Args:
            state: the estimate. sent: (PB, n) rad, where joints are sent at these moments, P = STOP_MOMENTS + 2.
        """


class StiffDrives(DriveLaw):
    """Stiff drives: the torque of the motion itself, by the nominal model."""

    def __init__(self, spec: RobotSpec, fleet: Fleet) -> None:
        """Take the model, 2B robots wide."""
        self._fleet = fleet.resized(-(-fleet.robots // 2) * (STOP_MOMENTS + 2))
        self.torque_limit = spec.margins.tau * torque_max(spec)

    def torque(self, state: State, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Return inverse dynamics, as `Fleet.torque`."""
        return self._fleet.torque(q, qd, qdd)

    def expected_poses(self, state: State, sent: Floats) -> Floats:
        """Return the poses where joints are sent."""
        return sent


class CompliantDrives(StiffDrives):
    """Drives of a robot with a floating base and their own gains: its weight moves joints away from what is sent.

    What the ground adds to the torque of the motion is limited by the drives themselves, to `margins.tau` of the range.
    """

    expectations: ClassVar[int] = 2

    def __init__(self, spec: RobotSpec, fleet: Fleet) -> None:
        """Take the model, 2B robots wide."""
        super().__init__(spec, fleet)
        self.current_share = spec.margins.tau

    def limited(self, tau: Floats) -> Floats:
        """Return torques inside the limit: the model that they come from does not know the ground."""
        return np.minimum(np.maximum(tau, -self.torque_limit), self.torque_limit)

    def expected_poses(self, state: State, sent: Floats) -> Floats:
        """Return where joints are sent, then poses as far from there as joints are now: they may not catch up."""
        deviation = state.q - sent[: len(state.q)]
        return np.concatenate((sent, sent + np.tile(deviation, (STOP_MOMENTS + 2, 1))))


class TorqueDrives(StiffDrives):
    """Stiff drives of a robot in torque mode: its stops need the torque of friction too, which the policy's had.

    A stop begins at an estimate, which may be far behind a push while packets are lost. What the drives that take over
    make of the difference is limited by the drives themselves: they saturate before the end of their range.
    """

    current_share = 0.95

    def torque(self, state: State, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Return inverse dynamics and friction."""
        return super().torque(state, q, qd, qdd) + self._fleet.friction(qd)


class SpringDrives(DriveLaw):
    """Drives that act as springs: the torque of the angle between setpoint and joint, up to `margins.tau` of the range.

    An angle that would need more is not refused: policies are trained on drives that saturate.
    """

    def __init__(self, spec: RobotSpec, gains: Gains) -> None:
        self._gains, self.current_share = gains, spec.margins.tau
        self._tau_max = self.current_share * torque_max(spec)
        self._twice_qdd = 2.0 * spec.joint_array("qdd_max")
        self.torque_limit = np.full(spec.n, np.inf)

    def torque(self, state: State, q: Floats, qd: Floats, qdd: Floats) -> Floats:
        """Return the torque that drives compute, from the estimate of now."""
        copies = len(q) // len(state.q)
        error, speed = q - np.tile(state.q, (copies, 1)), np.tile(state.qd, (copies, 1))
        tau = self._gains.kp * error - self._gains.kd * speed
        return np.minimum(np.maximum(tau, -self._tau_max), self._tau_max)

    def expected_poses(self, state: State, sent: Floats) -> Floats:
        """Return where joints are, and where they come to if they brake at `qdd_max`: not where they are sent.

        At a share s of its speed a joint that brakes evenly has 1 − s² of its way behind it.
        """
        distance = state.qd * np.abs(state.qd) / self._twice_qdd
        return (state.q + DISTANCE_BRAKED * distance).reshape(sent.shape)


def drive_law(spec: RobotSpec, action: ControlMode, gains: Gains | None, fleet: Fleet) -> DriveLaw:
    """Return the law of drives in the mode of an action: springs on a floating base with the gains of training."""
    spec = spec.in_mode(action)
    if action is ControlMode.TORQUE:
        return TorqueDrives(spec, fleet)
    if "floating_base" not in spec.capabilities:
        return StiffDrives(spec, fleet)
    return SpringDrives(spec, gains) if gains and gains.stiff else CompliantDrives(spec, fleet)
