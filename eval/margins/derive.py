"""Margins that limits need: the worst excess found, and what noise may add to it."""

import math
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from eval.bench.stop_search import POPULATION, SEED, StopSearch
from eval.margins.excess import BINS, SHARES
from robots.arrays import Floats
from robots.capabilities import required
from robots.models.fleet import Fleet
from robots.spec import RobotSpec

PER_HOUR = 1e-6
"""Passes of a margin per hour of operation, where noise decides."""
POSES = 512
"""Random poses, of which that counts at which errors of joints move the tool most."""
SHARE_STEP, LENGTH_STEP = 0.01, 0.001
"""Margins are rounded to these, in the safe direction; rad and m."""
ROUNDING = 1e-9


class Need(NamedTuple):
    """Margin that a quantity needs.

    Attributes:
        quantity: as in `Excess`. planned: share of the limit at which the excess counts most; 0 if it is no share.
        worst: largest excess found there. noise: added by noise. stop: added between the checked moments of a stop.
        key: of robot.toml. present, needed: margins; the present one suffices if it is on the safe side.
    """

    quantity: str
    planned: float
    worst: float
    noise: float
    stop: float
    key: str
    present: float
    needed: float

    @property
    def holds(self) -> bool:
        """True if the present margin suffices."""
        more = self.present - self.needed
        return more <= 1e-9 if self.quantity in SHARES else more >= -1e-9


def worst_bin(excess: Floats) -> int:
    """Return the bin of planned shares in which planned value and excess (bins,) come closest to the limit."""
    return int(np.argmax((1.0 + np.arange(len(excess))) / len(excess) + excess))


def noise_of(spec: RobotSpec, error: Floats) -> dict[str, float]:
    """Return what errors of the estimate add to each excess, at most `PER_HOUR`, where setpoints are predicted from it.

    Errors are taken as normal and as independent in each tick. Those of joints add up in the tool.

    Args:
        error: (2, n) rad and rad/s, their standard deviations.
    """
    ticks_per_hour = 3600.0 / spec.dt
    far = float(norm.isf(PER_HOUR / (ticks_per_hour * spec.n) / 2.0))
    q, qd = far * error
    found = {"angle": float(q.max()), "speed": float((qd / spec.joint_array("qd_max")).max())}
    if spec.workspace:
        poses = np.random.default_rng(0).uniform(*spec.pose_range, (POSES, spec.n))
        kinematics = Fleet(spec, POSES).kinematics(poses)
        squares = [np.square(kinematics.tool_velocity(np.tile(unit, (POSES, 1)))) for unit in np.eye(spec.n)]
        levers = np.sum(squares, axis=2)
        position, velocity = (float(np.sqrt((each**2 @ levers).max())) for each in (q, qd))
        found |= {"workspace": position, "gap": position}
        found["tool_speed"] = velocity / spec.workspace.tool_speed_max
    return found


def share_needed(excess: Floats, noise: float) -> float:
    """Return the largest share of a limit up to which planned values and excess (bins,) stay below it.

    Shares that nobody planned are left out.
    """
    for place in np.flatnonzero(np.isfinite(excess)):
        least, top = place / BINS, (place + 1) / BINS
        share = 1.0 - float(excess[place]) - noise
        if share < top:
            return float(max(share, least))
    return 1.0


def stop_excess(spec: RobotSpec, generations: int) -> dict[str, float]:
    """Return how far the worst accepted stop goes beyond its checked moments: a share of tool_speed_max, and m."""
    if spec.workspace is None:
        return {}
    search = StopSearch(spec, POPULATION)
    found = {name: search.worst(name, generations, SEED) - bound for name, bound in search.bounds.items()}
    walls = max(found["tool depth"], found["tool radius"]) * spec.workspace.radius_max
    return {"tool_speed": max(found["tool speed"], 0.0), "workspace": max(walls, 0.0)}


def need(spec: RobotSpec, quantity: str, worst: Floats, noise: float, stop: float) -> Need:
    """Return the margin that a quantity needs, of a robot in one mode.

    Args:
        worst: (bins,) largest excess of all trials. noise, stop: as in `Need`.
    """
    place = worst_bin(worst)
    planned, excess = (place + 1) / BINS if quantity in SHARES else 0.0, float(worst[place])
    if quantity in SHARES:
        needed = math.floor((share_needed(worst, noise) - stop) / SHARE_STEP + ROUNDING) * SHARE_STEP
    else:
        needed = math.ceil((excess + noise + stop) / LENGTH_STEP - ROUNDING) * LENGTH_STEP
    key, present = _margin(spec, quantity)
    return Need(quantity, planned, excess, noise, stop, key, present, round(needed, 3))


def _margin(spec: RobotSpec, quantity: str) -> tuple[str, float]:
    """Return the key of the margin that covers a quantity, and the present margin."""
    margins = spec.margins
    key, value = {
        "speed": ("speed", margins.speed),
        "tau": ("tau", margins.tau),
        "tool_speed": ("tool_speed", margins.tool_speed or margins.speed),
        "angle": ("q_soft_rad", margins.q_soft_rad),
        "workspace": ("workspace_m", margins.workspace_m),
        "gap": ("collision_m", margins.collision_m),
    }[quantity]
    return key, required(value)
