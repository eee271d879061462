"""Margins that limits need: the worst excess found, and what noise may add to it."""

import math
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from eval.bench.stop_search import GAP_SCALE_M, POPULATION, SEED, StopSearch
from eval.margins.excess import BINS, SHARES
from robots.arrays import Floats
from robots.capabilities import required
from robots.errors import ConfigError
from robots.models.fleet import Fleet
from robots.spec import RobotSpec

PER_HOUR = 1e-6
"""Passes of a margin per hour of operation, where noise decides."""
POSES = 8192
"""Random poses, of which that counts at which errors of joints move the tool most."""
SHARE_STEP, LENGTH_STEP = 0.01, 0.001
"""Margins are rounded to these, in the safe direction; rad and m."""
ROUNDING = 1e-9


class Need(NamedTuple):
    """Margin that a quantity needs.

    Attributes:
        quantity: as in `Excess`. planned: largest share of the limit that was planned; 0 if it is no share.
        worst: the excess that decides. noise: added by errors of the estimate. stop: by a stop between its checked
            moments.
        key: of robot.toml. present, needed: margins; the present one suffices if it is on the safe side. The needed one
            is infinite where no share that was planned came to its limit.
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
        return more <= ROUNDING if self.quantity in SHARES else more >= -ROUNDING


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
    if "tool" in spec.capabilities:
        poses = np.random.default_rng(0).uniform(*spec.pose_range, (POSES, spec.n))
        kinematics = Fleet(spec, POSES).kinematics(poses)
        squares = [np.square(kinematics.tool_velocity(np.tile(unit, (POSES, 1)))) for unit in np.eye(spec.n)]
        levers = np.sum(squares, axis=2)
        position, velocity = (float(np.sqrt((each**2 @ levers).max())) for each in (q, qd))
        found |= {"workspace": position, "gap": position}
        if spec.workspace:
            found["tool_speed"] = velocity / spec.workspace.tool_speed_max
    return found


def share_needed(excess: Floats, added: float) -> tuple[float, int]:
    """Return the share of a limit up to which planned values and excess stay below it, and the bin that decides.

    Args:
        excess: (bins,) over the upper end of each bin; -inf for shares that nobody planned, which are left out.
        added: to each excess.

    Returns:
        The share is infinite if no bin comes to the limit; the nearest one decides then.
    """
    tops = (1.0 + np.arange(BINS)) / BINS
    beyond = tops + excess + added - 1.0
    passed = np.flatnonzero(~(beyond <= 0.0))
    if not len(passed):
        return math.inf, int(np.argmax(beyond))
    place = int(passed[0])
    return float(np.nan_to_num(max(tops[place] - beyond[place], place / BINS))), place


def stop_excess(spec: RobotSpec, generations: int) -> dict[str, float]:
    """Return how far the worst accepted stop goes beyond its checked moments: shares of limits, and m.

    Raises:
        ConfigError: no stop was accepted.
    """
    search = StopSearch(spec, POPULATION)
    found = {name: search.worst(name, generations, SEED) - bound for name, bound in search.bounds.items()}
    if np.isnan(list(found.values())).any():
        raise ConfigError(f"{spec.folder}: no stop from a pose inside the working ranges is accepted")
    more = {name: max(value, 0.0) for name, value in found.items()}
    by_quantity = {"tau": more["torque"]}
    if spec.workspace:
        walls = max(more["tool depth"], more["tool radius"]) * spec.workspace.radius_max
        by_quantity |= {"tool_speed": more["tool speed"], "workspace": walls}
    if "gap" in more:
        by_quantity["gap"] = more["gap"] * GAP_SCALE_M
    return by_quantity


def need(spec: RobotSpec, quantity: str, worst: Floats, noise: float, stop: float) -> Need:
    """Return the margin that a quantity needs, of a robot in one mode.

    Args:
        worst: (bins,) largest excess of all trials. noise, stop: as in `Need`.

    Raises:
        ConfigError: no robot was in operation.
    """
    planned = np.flatnonzero(~np.isneginf(worst))
    if not len(planned):
        raise ConfigError(f"{spec.folder}: no robot could be armed, or was in operation for long enough")
    key, present = _margin(spec, quantity)
    if quantity not in SHARES:
        excess = float(worst[0])
        needed = math.ceil((excess + noise + stop) / LENGTH_STEP - ROUNDING) * LENGTH_STEP
        return Need(quantity, 0.0, excess, noise, stop, key, present, round(needed, 3))
    share, place = share_needed(worst, noise)
    if math.isfinite(share):
        share = round(math.floor((share - stop) / SHARE_STEP + ROUNDING) * SHARE_STEP, 3)
    top = (float(planned[-1]) + 1.0) / BINS
    return Need(quantity, top, float(worst[place]), noise, stop, key, present, share)


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
