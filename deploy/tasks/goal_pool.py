"""Reachable goals of an arm, uniform in volume.

Every goal is the tool position of a joint configuration inside the working range that every safety check accepts.
"""

from dataclasses import dataclass

import numpy as np

from deploy.safety.safety import Safety
from robots.arrays import Floats
from robots.errors import RobotError
from robots.margins import Margins
from robots.models.fleet import Fleet
from robots.spec import RobotSpec

GOALS_SEED = 20_250_811
"""Seed of the pool, the same for all: a robot's own seed decides the order of its goals."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReachConfig:
    """Goal region, period and tolerance.

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


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalPool:
    """Points the arm can reach.

    Attributes:
        q: (K, n) rad, a configuration that reaches each. tool: (K, 3) m. cumulative_probability: (K,).
    """

    q: Floats
    tool: Floats
    cumulative_probability: Floats


_POOLS: dict[tuple[str, Margins, ReachConfig], GoalPool] = {}


def goal_pool(spec: RobotSpec, config: ReachConfig) -> GoalPool:
    """Return the pool of a robot with the margins of its mode, sampled once in a process: it takes half a second.

    Raises:
        RobotError: no goal can be reached.
    """
    key = spec.digest, spec.margins, config
    if key not in _POOLS:
        _POOLS[key] = sample_pool(spec, config)
    return _POOLS[key]


def sample_pool(spec: RobotSpec, config: ReachConfig) -> GoalPool:
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
    return GoalPool(q=q, tool=tool, cumulative_probability=np.cumsum(weight) / np.cumsum(weight)[-1])


def _poses_in_shell(spec: RobotSpec, config: ReachConfig) -> tuple[Floats, Floats]:
    """Return (K, n) rad and (K, 3) m, configurations with their tool where goals may be; not yet checked for safety.

    Beyond a singularity lies another branch of the arm, and the singularity check lets nobody through: only
    configurations on the home pose's branch count.
    """
    if spec.workspace is None:
        raise RobotError(f"{spec.folder / 'robot.toml'}: workspace: found none, expected one to reach in")
    low, high = spec.pose_range
    margin = 2 * spec.margins.q_target_rad
    q = np.random.default_rng(GOALS_SEED).uniform(low + margin, high - margin, (config.candidates, spec.n))
    kinematics = Fleet(spec, len(q)).kinematics(q)
    tool = kinematics.tool_position
    radius = np.linalg.norm(tool - np.array(spec.workspace.centre), axis=1)
    fine = (radius >= config.radius_min) & (radius <= config.radius_max) & (tool[:, 2] >= config.z_min)
    fine &= np.hypot(tool[:, 0], tool[:, 1]) >= config.axis_min
    fine &= kinematics.manipulability() >= config.manipulability_min
    return q[fine], tool[fine]
