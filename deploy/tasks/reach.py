"""Reach: bring the tool to a point, then to the next, for a whole shift.

Goals are uniform in volume over what the arm can reach: every goal is the tool position of a joint configuration
inside the working range that every safety check accepts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deploy.masks import any_true
from deploy.safety.safety import Safety
from deploy.stage import Stage
from robots.arrays import Bools, Floats
from robots.errors import RobotError
from robots.models.fleet import Fleet
from robots.randomness import keyed, keys
from robots.spec import RobotSpec

GOALS_SEED = 20_250_811
"""One pool of goals for everybody: what a robot's seed chooses is the order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReachConfig:
    """The task.

    Attributes:
        radius_min, radius_max: m, the shell around the workspace's centre.
        z_min: m, least height of a goal.
        axis_min: m, least distance from the world's z axis: the vendor warns of the cylinder above and below the base,
            where the shoulder is near its singularity. Source: Universal Robots, UR5e User Manual, Workspace.
        manipulability_min: least manipulability, m³, of the configuration that reaches a goal, so that the way there
            need not brush a singularity.
        period_s: s for each goal. tolerance_m: m, how near counts.
        candidates: joint configurations tried for the pool. cell_m: m, grid on which volume is counted.
    """

    radius_min: float = 0.25
    radius_max: float = 0.80
    z_min: float = 0.10
    axis_min: float = 0.25
    period_s: float = 4.0
    tolerance_m: float = 0.02
    manipulability_min: float = 0.004
    candidates: int = 80_000
    cell_m: float = 0.05


class Reach(Stage):
    """Goals of B robots, by the robot's own estimate: `reached` is what the runtime believes, not a proof."""

    carried = ("goal", "elapsed", "number", "attempted", "reached", "ended", "ended_goal")

    def __init__(
        self, spec: RobotSpec, seeds: Sequence[np.random.SeedSequence], config: ReachConfig | None = None
    ) -> None:
        """Sample the pool and give every robot its first goal.

        Args:
            spec: the robot.
            seeds: B seeds.
            config: the task; the standard one by default.
        """
        self.config, robots = config or ReachConfig(), len(seeds)
        self._keys = keys(seeds, purpose=0)
        self.pool = goal_pool(spec, self.config)
        self._period = round(self.config.period_s / spec.dt)
        self.goal, self.ended_goal = np.zeros((robots, 3)), np.zeros((robots, 3))
        self.elapsed, self.number, self.attempted, self.reached = np.zeros((4, robots), dtype=np.int64)
        self.ended = np.zeros(robots, dtype=bool)
        self._choose(np.ones(robots, dtype=bool))

    @property
    def tolerance(self) -> float:
        """m, how near to a goal counts."""
        return self.config.tolerance_m

    def reset(self, ids: Bools) -> None:
        """A fresh goal and a full period for robots where `ids` (B,) holds."""
        self.elapsed[ids] = 0
        self._choose(ids)

    def step(self, tool: Floats, running: Bools) -> None:
        """Count one tick.

        Args:
            tool: (B, 3) m, where the robot believes its tool is.
            running: (B,) whether it is at work: a robot that is stopped reaches nothing.
        """
        self.elapsed += 1
        np.greater_equal(self.elapsed, self._period, out=self.ended)
        if not any_true(self.ended):
            return
        near = ((tool - self.goal) ** 2).sum(axis=1) <= self.config.tolerance_m**2
        self.attempted += self.ended
        self.reached += self.ended & near & running
        self.ended_goal[self.ended] = self.goal[self.ended]
        self.reset(self.ended)

    def _choose(self, ids: Bools) -> None:
        for robot in np.flatnonzero(ids):
            u = keyed(self._keys[robot], int(self.number[robot])).random()
            self.goal[robot] = self.pool.tool[np.searchsorted(self.pool.chance, u)]
            self.number[robot] += 1


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalPool:
    """Points the arm can reach.

    Attributes:
        q: (K, n) rad, a configuration that reaches each. tool: (K, 3) m. chance: (K,) cumulative, ends at 1.
    """

    q: Floats
    tool: Floats
    chance: Floats


def goal_pool(spec: RobotSpec, config: ReachConfig) -> GoalPool:
    """Sample the pool.

    Tool positions of uniform joint configurations crowd where the arm folds; weighting each by one over the number
    of its cell makes the choice uniform in volume.

    Raises:
        RobotError: there is none.
    """
    q, tool = _poses_in_shell(spec, config)
    safe = (
        Safety(spec, Fleet(spec, len(q), collisions=True)).check_poses(q) == 0
        if len(q)
        else np.zeros(0, bool)
    )
    if not safe.any():
        raise RobotError(
            f"{spec.folder / 'robot.toml'}: of {config.candidates} poses inside the working ranges {len(q)} have the"
            f" tool where goals may be ({config.radius_min} to {config.radius_max} m from workspace.centre, z at least"
            f" {config.z_min} m, {config.axis_min} m from the z axis) and a manipulability of at least"
            f" {config.manipulability_min} with the sign of the home pose's; none of them is safe: no goal can be set,"
            " expected at least 1"
        )
    q, tool = q[safe], tool[safe]
    _, cell, count = np.unique(
        np.floor(tool / config.cell_m), axis=0, return_inverse=True, return_counts=True
    )
    weight = 1.0 / count[cell]
    return GoalPool(q=q, tool=tool, chance=np.cumsum(weight) / np.cumsum(weight)[-1])


def _poses_in_shell(spec: RobotSpec, config: ReachConfig) -> tuple[Floats, Floats]:
    """(K, n) rad and (K, 3) m: configurations with their tool where goals may be; whether they are safe costs more.

    Beyond a singularity lies another branch of the arm, and the singularity check lets nobody through: only
    configurations on the home pose's branch count.
    """
    if spec.workspace is None:
        raise RobotError(f"{spec.folder / 'robot.toml'}: workspace: found none, expected one to reach in")
    low, high = (spec.joint_array(f"q_{end}") for end in ("min", "max"))
    margin = 2 * spec.margins.q_target_rad
    q = np.random.default_rng(GOALS_SEED).uniform(low + margin, high - margin, (config.candidates, spec.n))
    kinematics = Fleet(spec, len(q)).kinematics(q)
    tool = kinematics.tool_position
    radius = np.linalg.norm(tool - np.array(spec.workspace.centre), axis=1)
    fine = (radius >= config.radius_min) & (radius <= config.radius_max) & (tool[:, 2] >= config.z_min)
    fine &= np.hypot(tool[:, 0], tool[:, 1]) >= config.axis_min
    fine &= kinematics.manipulability() >= config.manipulability_min
    return q[fine], tool[fine]
