"""Planar reach: bring the tool of a planar arm of three hinges to one point of its plane after another."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from deploy.tasks.success import CoreGoals, SuccessCriterion
from deploy.tasks.tool_goals import ToolGoals
from robots.arrays import Bools, Floats
from robots.errors import RobotError
from robots.models.planar_chain import PlanarChain
from robots.spec import RobotSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarReachConfig:
    """Goal region, period and tolerance.

    Attributes:
        radius_min, radius_max: m from the first hinge. angle_max: rad to either side of the stretched arm.
        period_s: s for each goal.
        tolerance_m: m, the radius of the goal's sphere: the centre of the tool must be inside of it.
        core_share: of each hinge's working range, around its middle: goals that need more are counted apart.
    """

    radius_min: float = 0.3
    radius_max: float = 0.85
    angle_max: float = np.pi / 2
    period_s: float = 4.0
    tolerance_m: float = 0.03
    core_share: float = 0.9


class PlanarReach(ToolGoals):
    """Tool positions in the arm's plane, m, world; uniform in angle and in distance from the first hinge."""

    name = "planar_reach"
    config: ClassVar[PlanarReachConfig] = PlanarReachConfig()
    observation: ClassVar[tuple[str, ...]] = ("joint_position", "tool_position", "goal_position")

    def __init__(self, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence]) -> None:
        self._chain = PlanarChain.of_robot(spec)
        super().__init__(spec, seeds)

    @classmethod
    def misfit(cls, spec: RobotSpec) -> str:
        """Describe what the robot lacks of a planar chain; empty if nothing."""
        try:
            PlanarChain.of_robot(spec)
        except RobotError as e:
            return f"needs a planar arm: {e}"
        return ""

    @classmethod
    def success_criterion(cls, spec: RobotSpec) -> SuccessCriterion:
        """Within `tolerance_m` when the period ends; core goals need at most `core_share` of each range."""
        config, chain = cls.config, PlanarChain.of_robot(spec)
        joints = list(chain.joints)
        low, high = (end[joints] for end in spec.pose_range)
        share = np.where(np.isinf(spec.joint_array("q_max")[joints]), 1.0, config.core_share)
        middle, reach = (high + low) / 2, share * (high - low) / 2

        def contains(goal: Floats) -> Bools:
            return chain.reaches(goal, middle - reach, middle + reach)

        core = CoreGoals(f"inside {100 * config.core_share:g} % of the joint ranges", contains)
        return SuccessCriterion(
            size=cls.size, period_s=config.period_s, tolerance=config.tolerance_m, core=core
        )

    def sample_goal(self, rng: np.random.Generator) -> Floats:
        """(3,) m, uniform in angle and radius."""
        config = self.config
        angle = rng.uniform(-config.angle_max, config.angle_max)
        radius = rng.uniform(config.radius_min, config.radius_max)
        return self._chain.world(np.asarray(radius * np.exp(1j * angle)))
