"""Plans of Ruckig for many robots: the ways they are on, and the stops that could begin.

One Ruckig instance plans the joints of `BLOCK` robots in one call; more robots take their turns in it, and what it
works with stays in the cache. Ruckig plans each joint for itself and remembers nothing between plans, so a robot's bits
depend on no neighbour, and a resumed run repeats them.
"""

import struct
from itertools import chain

import numpy as np
from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from deploy.masks import all_true, any_true
from robots.arrays import Bools, Floats, Ints
from robots.models.blocks import turns
from robots.spec import RobotSpec

EDGE = 1e-8
"""rad/s. Ruckig may plan badly when the speed it is bound to reach is this near the limit; the state is moved in."""

NUDGE = 1e-9
"""rad. How far a target is moved where Ruckig has no plan for the exact one."""

RENEW_S = 1.0
"""s. No trajectory is read later than this, so that rounding at its end cannot add up to a drift; only where a stop
may take longer than this, it is that long."""


class _Plans:
    """What ways and stops share: a trajectory for each block, or for each robot of a block that Ruckig cannot plan."""

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        self._turns, self._n, self._robots = turns(robots), spec.n, robots
        self._dt, self._longest = spec.dt, longest(spec)
        self._block, self._solo = _Planner(spec, self._turns[0].stop), _Planner(spec, 1)

    def _fill(self, origin: Floats, rows: slice, room: Trajectory) -> list[tuple[slice, Trajectory | None]]:
        """Trajectories of the robots `rows`, in `room` if one serves them all; `origin` as in `Ways.plan`."""
        if self._block.plan(origin[rows], room):
            return [(rows, room)]
        return [(one, self._alone(origin[one])) for one in _each(rows)]

    def _numbers(self, parts: tuple[list[float], ...]) -> Floats:
        """(rows, parts, n), in a third of the time that `np.array` takes."""
        numbers: list[float] = []
        for part in parts:
            numbers += part
        flat = np.frombuffer(struct.pack(f"{len(numbers)}d", *numbers)).reshape(len(parts), -1)
        return flat[:, :-1].reshape(len(parts), -1, self._n).swapaxes(0, 1)

    def _alone(self, origin: Floats) -> Trajectory | None:
        """Ruckig fails for a whole block when one joint has no solution: find it, spare the others.

        Where two shapes of profile meet exactly, as at a distance of 2a³/j², it finds neither: a rounded acceleration
        or a target next to it cures the failures seen. A robot that stays without a plan gets NaN, which safety
        refuses.
        """
        trajectory, n = self._solo.room(), self._n
        if self._solo.plan(origin, trajectory):
            return trajectory
        near = origin.copy()
        near[:, 2 * n : 3 * n] = near[:, 2 * n : 3 * n].round(9)
        near[:, 3 * n : 4 * n] += NUDGE
        return trajectory if self._solo.plan(near, trajectory) else None


class Ways(_Plans):
    """Trajectories that B robots are on, read for a while."""

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        super().__init__(spec, robots)
        self._rooms = [self._block.room() for _ in self._turns]
        self._planned: list[list[tuple[slice, Trajectory | None]]] = [[(rows, None)] for rows in self._turns]

    def plan(self, origin: Floats, changed: Bools | None = None) -> None:
        """Plan again for every block that holds a robot of `changed` (B,): the others there get what they have.

        Args:
            origin: (B, 4n + 2) q, qd, qdd where the trajectories begin, target, pace, and whether to brake instead.
            changed: robots with another origin than before; by default all.
        """
        for turn, rows in enumerate(self._turns):
            if changed is None or any_true(changed[rows]):
                self._planned[turn] = self._fill(origin, rows, self._rooms[turn])

    def at(self, ticks: Ints) -> Floats:
        """(B, 3, n) q, qd, qdd, so many ticks (B,) on; NaN where there is no plan."""
        out = np.empty((self._robots, 3, self._n))
        for rows, trajectory in chain.from_iterable(self._planned):
            if trajectory is None:
                out[rows] = np.nan
                continue
            ages = set(ticks[rows].tolist())
            for age in ages:
                here = ... if len(ages) == 1 else ticks[rows] == age
                out[rows][here] = self._numbers(trajectory.at_time(age * self._dt))[here]
        return out


class Stops(_Plans):
    """Stops that could begin: one block's is read before the next one's is planned, in the same room."""

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        super().__init__(spec, robots)
        self._room, self._midst = self._block.room(), _midst(spec)

    def points(self, origin: Floats) -> Floats:
        """(B, 5, n) q, qd, qdd one tick on, q in the midst, and q at the end; NaN where there is no plan."""
        out = np.empty((self._robots, 5, self._n))
        for turn in self._turns:
            for rows, trajectory in self._fill(origin, turn, self._room):
                out[rows] = np.nan if trajectory is None else self._numbers(self._parts(trajectory))
        return out

    def _parts(self, stop: Trajectory) -> tuple[list[float], ...]:
        return (*stop.at_time(self._dt), stop.at_time(self._midst)[0], stop.at_time(self._longest)[0])


class _Planner:
    """One Ruckig instance for some robots.

    After the joints of the robots comes a clock: a joint that is on its way for longer than any trajectory is read.
    Beyond the end of the last joint Ruckig computes in another order, with other last bits; this way that never comes,
    and nobody's bits depend on when the neighbours arrive.
    """

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        self._n, self._size = spec.n, robots * spec.n + 1
        self._otg, self._in = Ruckig(self._size, spec.dt), InputParameter(self._size)
        self._qd_max = np.tile(spec.margins.speed * spec.joint_array("qd_max"), (robots, 1))
        self._twice_jerk = np.tile(2 * spec.joint_array("qddd_max"), (robots, 1))
        self._qdd_max = np.tile(spec.joint_array("qdd_max"), (robots, 1))
        self._in.max_jerk = [*self._twice_jerk.ravel() / 2, 1.0]
        self._in.synchronization = Synchronization.No
        self._in.per_dof_control_interface = [ControlInterface.Position] * self._size
        self._braking = np.zeros(robots, dtype=bool)
        self._limit(np.ones(robots))
        # What Ruckig is told, q, qd, qdd and target, with the clock at the end of each.
        self._told = np.zeros((4, self._size))
        self._told[3, -1] = 2 * longest(spec)
        self._joints = self._told[:, :-1].reshape(4, robots, spec.n)

    def room(self) -> Trajectory:
        """An empty trajectory for these robots and the clock."""
        return Trajectory(self._size)

    def plan(self, origin: Floats, trajectory: Trajectory) -> bool:
        """Fill `trajectory` for these robots, `origin` as in `Ways.plan`; whether Ruckig could."""
        self._brake(origin[:, -1] != 0)
        if not all_true(origin[:, -2] == self._pace):
            self._limit(origin[:, -2])
        self._joints[:] = origin[:, :-2].reshape(len(origin), 4, self._n).swapaxes(0, 1)
        if not all_true(self._braking):  # a stop knows no limit of speed
            self._move_inside()
        # As lists: Ruckig's binding reads an array number by number, in three times the time.
        q, qd, qdd, target = self._told.tolist()
        self._in.current_position, self._in.current_velocity, self._in.current_acceleration = q, qd, qdd
        self._in.target_position = target
        try:
            self._otg.calculate(self._in, trajectory)
        except RuckigError:
            return False
        return True

    def _brake(self, braking: Bools) -> None:
        """Choose for each robot: speed to zero, or position to a target."""
        if all_true(braking == self._braking):
            return
        self._braking[:] = braking
        kinds = [ControlInterface.Velocity if b else ControlInterface.Position for b in braking]
        of_joints = [kind for kind in kinds for _ in range(self._n)]
        self._in.per_dof_control_interface = [*of_joints, ControlInterface.Position]

    def _limit(self, pace: Floats) -> None:
        """Bound speed and acceleration of each robot to its share (R,)."""
        self._pace = pace.copy()
        self._speed = self._qd_max * pace[:, None]
        self._in.max_velocity = [*self._speed.ravel().tolist(), 1.0]
        self._in.max_acceleration = [*(self._qdd_max * pace[:, None]).ravel().tolist(), 1.0]

    def _move_inside(self) -> None:
        """Move speeds off the limit where a target is followed."""
        _, qd, qdd, _ = self._joints
        bound = qd + qdd * np.abs(qdd) / self._twice_jerk
        edge = (np.abs(np.abs(bound) - self._speed) < EDGE) & ~self._braking[:, None]
        if any_true(edge):
            qd -= np.where(edge, np.sign(bound) * EDGE, 0.0)


def longest(spec: RobotSpec) -> float:
    """Seconds after which no trajectory is read any more."""
    return max(RENEW_S, spec.stop_s)


def _midst(spec: RobotSpec) -> float:
    """How many s into a stop: half of the time that the slowest joint needs from half its speed.

    The arm's path bends where joints come to rest one after another. Of 16,000 random stops of arm6 from up to 0.9 of
    full speed the tool's lowest point was up to 35 mm below both ends, and up to 14 mm below the lowest of the ends and
    this point; from up to 0.6, 12 mm and 6 mm.
    """
    qdd_max = spec.joint_array("qdd_max")
    whole = spec.margins.speed * spec.joint_array("qd_max") / 2 / qdd_max
    return float((whole + qdd_max / spec.joint_array("qddd_max")).max() / 2)


def _each(rows: slice) -> list[slice]:
    return [slice(row, row + 1) for row in range(rows.start, rows.stop)]
