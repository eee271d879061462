"""Estimator stage that a capability of a robot brings into the tick."""

from abc import ABC, abstractmethod
from typing import ClassVar

from deploy.stage import Stage
from deploy.state import Sample, State
from robots.arrays import Bools
from robots.capabilities import Capability
from robots.sensors import Kind
from robots.spec import RobotSpec


class CapabilityEstimator(Stage, ABC):
    """Stage after the joints' estimator, present in robots with `capability`."""

    capability: ClassVar[Capability]
    sensors: ClassVar[tuple[Kind, ...]] = ()
    """Sensors that it reads, of those that the robot has."""

    @abstractmethod
    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Allocate for B robots."""

    @abstractmethod
    def step(self, t: float, sample: Sample, state: State, due: bool) -> State:
        """Return the state at `t` s with this capability's estimate; `due`: the policy observes in this tick."""

    def reset(self, ids: Bools) -> None:
        """Forget robots where `ids` (B,) holds; nothing by default: the estimate follows from the joints."""
