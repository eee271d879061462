"""Estimator stages of the capabilities that a robot has."""

from deploy.estimation.capability import CapabilityEstimator
from deploy.estimation.floating_base.floating_base import FloatingBase
from deploy.estimation.tool_kinematics import ToolKinematics
from deploy.stage import Stage
from deploy.state import Sample, State
from robots.arrays import Bools
from robots.capabilities import Capability
from robots.spec import RobotSpec

ESTIMATORS: tuple[type[CapabilityEstimator], ...] = (FloatingBase, ToolKinematics)
"""In the order in which they step."""


class CapabilityEstimators(Stage):
    """Estimator stages of one kind of robot, in the order of `ESTIMATORS`.

    Attributes:
        by_name: those of the capabilities that the robot has.
    """

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        present = [kind for kind in ESTIMATORS if kind.capability in spec.capabilities]
        self.by_name: dict[Capability, CapabilityEstimator] = {
            kind.capability: kind(spec, robots) for kind in present
        }

    def stages(self) -> dict[str, Stage]:
        """The stages by the name of their capability."""
        return {str(name): stage for name, stage in self.by_name.items()}

    def step(self, t: float, sample: Sample, state: State, due: bool) -> State:
        """Return the state with every capability's estimate; arguments as in `CapabilityEstimator.step`."""
        for stage in self.by_name.values():
            state = stage.step(t, sample, state, due)
        return state

    def reset(self, ids: Bools) -> None:
        """Forget robots where `ids` (B,) holds."""
        for stage in self.by_name.values():
            stage.reset(ids)
