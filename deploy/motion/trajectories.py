"""Jerk-limited trajectories of Ruckig for many robots: those that they track, and the stops that could begin.

One Ruckig instance plans the joints of up to `BLOCK` robots in one call; more robots use it one block after another,
whose working memory stays in the cache. Ruckig plans each joint for itself and remembers nothing between plans, so a
robot's bits depend on no neighbour, and a resumed run repeats them.
"""

import struct
from itertools import chain

import numpy as np
from ruckig import Trajectory

from deploy.masks import any_true
from deploy.motion.ruckig_planner import RuckigPlanner, horizon_s
from deploy.state import BRAKING_SHARES, STOP_MOMENTS
from robots.arrays import Bools, Floats, Ints
from robots.models.blocks import block_rows
from robots.spec import RobotSpec

NUDGE = 1e-9
"""rad. Distance by which a target is moved where Ruckig has no plan for the exact one."""

Planned = tuple[slice, Trajectory | None]
"""Rows of some robots and their trajectory; None where Ruckig has no plan."""


class _BlockPlans:
    """A trajectory for each block of robots, or for each robot of a block that Ruckig cannot plan as a whole."""

    def __init__(self, spec: RobotSpec, robots: int, planner: type[RuckigPlanner] = RuckigPlanner) -> None:
        self._rows, self._n, self._robots = block_rows(robots, spec.n), spec.n, robots
        self._dt, self._horizon = spec.dt, horizon_s(spec)
        self._block, self._single = planner(spec, self._rows[0].stop), planner(spec, 1)

    def _plan_block(self, origin: Floats, rows: slice, trajectory: Trajectory) -> list[Planned]:
        """Plan the robots `rows`, in `trajectory` if one serves all; `origin` as in `TrackingTrajectories.plan`."""
        if self._block.plan(origin[rows], trajectory):
            return [(rows, trajectory)]
        singles = [slice(row, row + 1) for row in range(rows.start, rows.stop)]
        return [(single, self._plan_single(origin[single])) for single in singles]

    def _plan_single(self, origin: Floats) -> Trajectory | None:
        """Plan one robot of a block that failed: Ruckig fails for all of it when one joint has no solution.

        Where two shapes of profile meet exactly, as at a distance of 2a³/j², it finds neither: a rounded acceleration
        or a target next to it cures the failures seen. A robot that stays without a plan gets NaN, which safety
        refuses.
        """
        trajectory, n = self._single.empty_trajectory(), self._n
        if self._single.plan(origin, trajectory):
            return trajectory
        near = origin.copy()
        near[:, 2 * n : 3 * n] = near[:, 2 * n : 3 * n].round(9)
        near[:, 3 * n : 4 * n] += NUDGE
        return trajectory if self._single.plan(near, trajectory) else None

    def _stack(self, parts: tuple[list[float], ...]) -> Floats:
        """Return (rows, parts, n), in a third of the time that `np.array` takes."""
        numbers: list[float] = []
        for part in parts:
            numbers += part
        flat = np.frombuffer(struct.pack(f"{len(numbers)}d", *numbers)).reshape(len(parts), -1)
        return flat[:, :-1].reshape(len(parts), -1, self._n).swapaxes(0, 1)


class TrackingTrajectories(_BlockPlans):
    """Trajectories that B robots are on, read for many ticks; the planner decides on the meaning of targets."""

    def __init__(self, spec: RobotSpec, robots: int, planner: type[RuckigPlanner]) -> None:
        super().__init__(spec, robots, planner)
        self._trajectories = [self._block.empty_trajectory() for _ in self._rows]
        self._planned: list[list[Planned]] = [[(rows, None)] for rows in self._rows]

    def plan(self, origin: Floats, changed: Bools | None = None) -> None:
        """Plan again every block that holds a robot of `changed` (B,): the others in it get the same plan as before.

        An origin (B, 4n + 2) is q, qd, qdd where the trajectory begins, target, speed share, 1 to stop instead.
        """
        for block, rows in enumerate(self._rows):
            if changed is None or any_true(changed[rows]):
                self._planned[block] = self._plan_block(origin, rows, self._trajectories[block])

    def at(self, ticks: Ints) -> Floats:
        """Return (B, 3, n) q, qd, qdd, `ticks` (B,) after the origin; NaN where there is no plan."""
        out = np.empty((self._robots, 3, self._n))
        for rows, trajectory in chain.from_iterable(self._planned):
            if trajectory is None:
                out[rows] = np.nan
                continue
            ages = set(ticks[rows].tolist())
            for age in ages:
                here = ... if len(ages) == 1 else ticks[rows] == age
                out[rows][here] = self._stack(trajectory.at_time(age * self._dt))[here]
        return out


class StopTrajectories(_BlockPlans):
    """Stops that could begin. Those of one block are read before the next block is planned in the same memory."""

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        super().__init__(spec, robots)
        self._trajectory, self._moments = self._block.empty_trajectory(), stop_moments_s(spec)

    def points(self, origin: Floats) -> Floats:
        """Return (B, 4 + 3 STOP_MOMENTS, n); NaN where there is no plan.

        In order: q, qd, qdd one tick later and at each moment, q at the end.
        """
        out = np.empty((self._robots, 4 + 3 * STOP_MOMENTS, self._n))
        for block in self._rows:
            for rows, trajectory in self._plan_block(origin, block, self._trajectory):
                out[rows] = np.nan if trajectory is None else self._stack(self._parts(trajectory))
        return out

    def _parts(self, stop: Trajectory) -> tuple[list[float], ...]:
        moments = chain.from_iterable(stop.at_time(moment) for moment in (self._dt, *self._moments))
        return (*moments, stop.at_time(self._horizon)[0])


def stop_moments_s(spec: RobotSpec) -> tuple[float, ...]:
    """Return s after which a stop is checked: `BRAKING_SHARES` of the time that the second slowest joint needs.

    From half of its speed; of the only joint if there is one. The arm's path bends while joints come to rest one after
    another, most while the fast ones do. What happens between the moments: python -m eval.bench stops.
    """
    qdd_max = spec.joint_array("qdd_max")
    braking = spec.margins.speed * spec.joint_array("qd_max") / 2 / qdd_max
    whole = np.sort(braking + qdd_max / spec.joint_array("qddd_max"))
    all_but_one = float(whole[-2:][0])
    return tuple(share * all_but_one for share in BRAKING_SHARES)
