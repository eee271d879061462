"""Reach: bring the tool to one point after another."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from deploy.tasks.goal_pool import ReachConfig, goal_pool
from deploy.tasks.success import SuccessCriterion
from deploy.tasks.tool_goals import ToolGoals
from robots.arrays import Floats
from robots.capabilities import Capability
from robots.spec import RobotSpec


class Reach(ToolGoals):
    """Tool positions in the world, m, drawn from the pool of reachable goals."""

    name = "reach"
    needs: ClassVar[frozenset[Capability]] = frozenset({"tool", "workspace"})
    config: ClassVar[ReachConfig] = ReachConfig()
    observation: ClassVar[tuple[str, ...]] = (
        *("joint_position", "joint_velocity", "tool_position", "goal_from_tool", "goal_torque"),
        *("target_offset", "last_action"),
    )

    def __init__(self, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence]) -> None:
        self.pool = goal_pool(spec, self.config)
        super().__init__(spec, seeds)

    @classmethod
    def success_criterion(cls, spec: RobotSpec) -> SuccessCriterion:
        """Within `tolerance_m` when the period ends."""
        return SuccessCriterion(size=3, period_s=cls.config.period_s, tolerance=cls.config.tolerance_m)

    def sample_goal(self, rng: np.random.Generator) -> Floats:
        """(3,) m, uniform in the volume of the pool."""
        goal: Floats = self.pool.tool[np.searchsorted(self.pool.cumulative_probability, rng.random())]
        return goal

    def start_poses(self, rng: np.random.Generator) -> Floats:
        """(B, n) rad, joint configurations of the pool."""
        q: Floats = self.pool.q[rng.integers(len(self.pool.q), size=len(self.goal))]
        return q
