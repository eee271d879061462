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
    """Those of one kind of robot, in the order of `ESTIMATORS`."""

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        present = [kind for kind in ESTIMATORS if kind.capability in spec.capabilities]
        self._by_capability: dict[Capability, CapabilityEstimator] = {
            kind.capability: kind(spec, robots) for kind in present
        }

    def __getitem__(self, capability: Capability) -> CapabilityEstimator:
        return self._by_capability[capability]

    def __contains__(self, capability: Capability) -> bool:
        return capability in self._by_capability

    def stages(self) -> dict[str, Stage]:
        """The stages by the name of their capability."""
        return {str(name): stage for name, stage in self._by_capability.items()}

    def step(self, t: float, sample: Sample, state: State, due: bool) -> State:
        """Return the state with every capability's estimate; arguments as in `CapabilityEstimator.step`."""
        for stage in self._by_capability.values():
            state = stage.step(t, sample, state, due)
        return state

    def reset(self, ids: Bools) -> None:
        """Forget robots where `ids` (B,) holds."""
        for stage in self._by_capability.values():
            stage.reset(ids)
