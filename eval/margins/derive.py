"""Margins that limits need: the worst excess found, and what noise may add to it."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eval.bench.stop_search import POPULATION, SEED, StopSearch
from eval.margins.excess import BINS, SHARES, Values
from eval.margins.tail import level
from eval.margins.trial import TRIAL_S, Tried, Worst
from eval.shard.job import WIDTH
from robots.arrays import Floats
from robots.capabilities import required
from robots.spec import RobotSpec

PREDICTED = ("speed", "angle", "tool_speed", "workspace", "gap")
"""Quantities whose setpoints are predicted from the estimate in torque mode. In other modes, and of torques in all of
them, what is sent does not depend on samples, but for the stops that they lead to, which a policy can have as well."""
PER_HOUR = 1e-6
"""Passes of a margin per hour of operation, where noise decides."""
PROBABILITY = PER_HOUR * TRIAL_S / 3600.0
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
    """Return the bin of planned shares in which planned value and excess (trials, bins) come closest to the limit."""
    tops = (1.0 + np.arange(excess.shape[1])) / excess.shape[1]
    return int(np.argmax(tops + excess.max(axis=0)))


def find_worst(tried: Sequence[Tried], quantity: str) -> tuple[Worst, int, Floats]:
    """Return the worst trial of a quantity, its bin, and the largest excess (bins,) of all trials."""
    excess = np.concatenate([each.excess[quantity] for each in tried])
    place = worst_bin(excess)
    number = int(excess[:, place].argmax())
    trials, policy = [(each.trials, policy) for each in tried for policy in each.policies][number]
    robot = number % WIDTH  # a whole number of shards comes before it
    worst = Worst(trials.setting, trials.seed, trials.corners, policy, robot)
    return worst, place, excess.max(axis=0)


def noise_of(repeats: Values, quantity: str, place: int) -> float:
    """Return what noise adds to an excess at most `PER_HOUR`, from repeats of one trial."""
    found = repeats[quantity][:, place]
    found = found[np.isfinite(found)]
    return level(found, PROBABILITY) - float(np.median(found)) if len(found) else 0.0


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


def need(spec: RobotSpec, quantity: str, worst: Floats, place: int, noise: float, stop: float) -> Need:
    """Return the margin that a quantity needs, of a robot in one mode.

    Args:
        worst: (bins,) largest excess. place: the bin that decides.
    """
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
