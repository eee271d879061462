"""Tool of a robot by forward kinematics at the estimated joint angles."""

from typing import ClassVar

import numpy as np

from deploy.estimation.capability import CapabilityEstimator
from deploy.state import Sample, State
from robots.arrays import Floats
from robots.capabilities import Capability
from robots.models.fleet import Fleet
from robots.models.kinematics import Kinematics
from robots.spec import RobotSpec


class ToolKinematics(CapabilityEstimator):
    """Tools of B robots, updated in ticks in which the policy observes.

    Attributes:
        position: (B, 3) m in the world.
    """

    capability: ClassVar[Capability] = "tool"
    carried = ("position",)

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        self._fleet, self.position = Fleet(spec, robots), np.zeros((robots, 3))
        self._kinematics: Kinematics | None = None

    def step(self, t: float, sample: Sample, state: State, due: bool) -> State:
        """Place the tool at the estimated angles, if the policy is due."""
        del t, sample
        if due:
            self._kinematics = self._fleet.kinematics(state.q)
            self.position[:] = self._kinematics.tool_position
        return state

    def joint_torque(self, force: Floats) -> Floats:
        """(B, n) N·m, joint torques equal to a force (B, 3) N on the tool where it was placed last: Jᵀf.

        Raises:
            RuntimeError: the tool was not placed yet.
        """
        if self._kinematics is None:
            raise RuntimeError("the tool was not placed yet")
        return self._kinematics.torque_of_tool_force(force)
