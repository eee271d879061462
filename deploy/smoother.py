"""Jerk-limited trajectories with Ruckig; a stop is one of them.

One Ruckig instance plans the joints of `BLOCK` robots in one call; more robots take their turns in it, and what it
works with stays in the cache. A robot that does what was planned, for a target that has not changed, stays on its
trajectory; any other gets a new one. Ruckig plans each joint for itself and remembers nothing between plans, so a
robot's bits depend on no neighbour, and a resumed run repeats them.
"""

import struct
from collections.abc import Mapping
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from deploy.flags import every, some
from deploy.stage import Stage
from deploy.state import Bools, Floats, Ints, Setpoint
from robots.blocks import turns
from robots.spec import RobotSpec

EDGE = 1e-8
"""rad/s. Ruckig may plan badly when the speed it is bound to reach is this near the limit; the state is moved in."""

NUDGE = 1e-9
"""rad. How far a target is moved where Ruckig has no plan for the exact one."""

REST = 1e-6
"""rad/s and rad/s². What is left below is rounding, which Ruckig may take many periods to bring to nothing."""

RENEW_S = 1.0
"""s. No trajectory is read later than this, so that rounding at its end cannot add up to a drift; only where a stop
may take longer than this, it is that long."""


class Smoother(Stage):
    """The last SENT setpoint of B robots, the trajectories that they are on, and the stops that could begin.

    Attributes:
        q, qd, qdd: (B, n) rad, rad/s, rad/s², the last setpoint sent.
        origin: (B, 4n + 1) where each robot's trajectory began and what was asked then: q, qd, qdd, target, stopping.
        expected: (B, 4n + 1) the same of now, if all went as planned: a robot that differs gets a new trajectory.
        age: (B,) ticks since `origin`, less those at rest after a stop.
    """

    carried = ("q", "qd", "qdd", "origin", "expected", "age")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Build the planners: one for what comes next, one for stops."""
        shape = (robots, spec.n)
        self.q, self.qd, self.qdd = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self.origin = np.full((robots, 4 * spec.n + 1), np.nan)
        self.expected, self.age = self.origin.copy(), np.zeros(robots, dtype=np.int64)
        margin = spec.margins.q_target_rad
        self._q_min = np.tile(spec.joint_array("q_min") + margin, (robots, 1))
        self._q_max = np.tile(spec.joint_array("q_max") - margin, (robots, 1))
        self._ways, self._stops = _Trajectories(spec, robots), _Trajectories(spec, robots)
        self._renew, self._midst = round(_longest(spec) / spec.dt), _midst(spec)
        self._everybody = np.ones((robots, 1), dtype=bool)

    def next(self, q_target: Floats, stopping: Bools) -> Setpoint:
        """One step from the last sent setpoint: towards a target, or towards rest; NaN where Ruckig has no plan.

        Args:
            q_target: (B, n) rad, clamped here to the working range less its margin.
            stopping: (B,) robots that brake to rest instead.
        """
        target, stops = np.minimum(np.maximum(q_target, self._q_min), self._q_max), stopping[:, None]
        if some(stopping):
            target[stopping] = 0.0  # no matter: it must not count as asked anew
            self.age -= stopping & self.at_rest  # or rounding would creep on
        self.age += 1
        self._plan(np.concatenate((self.q, self.qd, self.qdd, target, stops), axis=1))
        planned = self._ways.at(self.age)
        self.expected[:, : planned[0].size] = planned.reshape(len(planned), -1)
        return _setpoint(planned)

    def _plan(self, now: Floats) -> None:
        """A new trajectory for every robot that is not where it was expected, is asked anew, or was long on one."""
        as_expected = now == self.expected
        old = self.age >= self._renew
        if every(as_expected) and not some(old):
            return
        left = ~as_expected.all(axis=1) | old
        self.origin[left], self.age[left] = now[left], 1
        self.expected[:] = now
        self._ways.plan(self.origin, left)

    def brake(self, start: Setpoint) -> tuple[Setpoint, Floats, Floats]:
        """A stop that would begin at `start`: its first step, and (B, n) rad in its midst and where it would end."""
        self._stops.plan(np.concatenate((start.q, start.qd, start.qdd, start.q, self._everybody), axis=1))
        stop = self._stops.stop_points(self._midst)
        return _setpoint(stop), stop[:, 3], stop[:, 4]

    def commit(self, sent: Setpoint) -> None:
        """Remember what was sent."""
        self.q[:], self.qd[:], self.qdd[:] = sent.q, sent.qd, sent.qdd

    def hold(self, ids: Bools, q: Floats) -> None:
        """Rest robots where `ids` (B,) holds at `q` (B, n) rad."""
        self.q[ids], self.qd[ids], self.qdd[ids] = q[ids], 0.0, 0.0

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back and plan the trajectories that they stand for."""
        super().restore(arrays)
        self._ways.plan(self.origin)

    @property
    def sent(self) -> Setpoint:
        """The last setpoint sent."""
        return Setpoint(q=self.q, qd=self.qd, qdd=self.qdd)

    @property
    def at_rest(self) -> Bools:
        """(B,) whether the last sent setpoint stands still."""
        return np.asarray(np.maximum(np.abs(self.qd), np.abs(self.qdd)).max(axis=1) < REST)


class _Trajectories:
    """Trajectories of B robots: one for each block, or one for each robot of a block that Ruckig cannot plan as one."""

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        self._turns, self._n, self._robots = turns(robots), spec.n, robots
        self._dt, self._longest = spec.dt, _longest(spec)
        self._block, self._solo = _Planner(spec, self._turns[0].stop), _Planner(spec, 1)
        self._common = [self._block.room() for _ in self._turns]
        self._planned: list[list[tuple[slice, Trajectory | None]]] = [[] for _ in self._turns]

    def plan(self, origin: Floats, changed: Bools | None = None) -> None:
        """Plan again for every block that holds a robot of `changed` (B,): the others there get what they have.

        Args:
            origin: (B, 4n + 1) q, qd, qdd where the trajectories begin, target, and whether to brake instead.
            changed: robots with another origin than before; by default all.
        """
        for turn, rows in enumerate(self._turns):
            if changed is not None and not some(changed[rows]):
                continue
            common = self._common[turn]
            if self._block.plan(origin[rows], common):
                self._planned[turn] = [(rows, common)]
            else:
                self._planned[turn] = [(one, self._alone(origin[one])) for one in _each(rows)]

    def at(self, ticks: Ints) -> Floats:
        """(B, 3, n) q, qd, qdd, so many ticks (B,) on; NaN where there is no plan."""
        out = np.full((self._robots, 3, self._n), np.nan)
        for rows, trajectory in chain.from_iterable(self._planned):
            if trajectory is None:
                continue
            ages = set(ticks[rows].tolist())
            for age in ages:
                here = True if len(ages) == 1 else (ticks[rows] == age)[:, None, None]
                np.copyto(out[rows], self._numbers(trajectory.at_time(age * self._dt)), where=here)
        return out

    def stop_points(self, midst: float) -> Floats:
        """(B, 5, n) q, qd, qdd one tick on, q after `midst` s, and q at the end; NaN where there is no plan."""
        out = np.full((self._robots, 5, self._n), np.nan)
        for rows, trajectory in chain.from_iterable(self._planned):
            if trajectory:
                q_midst, q_end = trajectory.at_time(midst)[0], trajectory.at_time(self._longest)[0]
                out[rows] = self._numbers((*trajectory.at_time(self._dt), q_midst, q_end))
        return out

    def _numbers(self, parts: tuple[list[float], ...]) -> Floats:
        """(rows, parts, n), in half of the time that `np.array` takes."""
        packed = struct.pack(f"{len(parts) * len(parts[0])}d", *chain.from_iterable(parts))
        flat = np.frombuffer(packed).reshape(len(parts), -1)
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


class _Planner:
    """One Ruckig instance for some robots.

    After the joints of the robots comes a clock: a joint that is on its way for longer than any trajectory is read.
    Beyond the end of the last joint Ruckig computes in another order, with other last bits; this way that never comes,
    and nobody's bits depend on when the neighbours arrive.
    """

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        self._n, self._size, self._longest = spec.n, robots * spec.n + 1, _longest(spec)
        self._otg, self._in = Ruckig(self._size, spec.dt), InputParameter(self._size)
        self._qd_max = np.tile(spec.margins.speed * spec.joint_array("qd_max"), (robots, 1))
        self._twice_jerk = np.tile(2 * spec.joint_array("qddd_max"), (robots, 1))
        self._in.max_velocity = [*self._qd_max.ravel(), 1.0]
        self._in.max_acceleration = [*np.tile(spec.joint_array("qdd_max"), robots), 1.0]
        self._in.max_jerk = [*self._twice_jerk.ravel() / 2, 1.0]
        self._in.synchronization = Synchronization.No
        self._in.per_dof_control_interface = [ControlInterface.Position] * self._size
        self._braking = np.zeros(robots, dtype=bool)
        self._aim([0.0] * (robots * spec.n))

    def room(self) -> Trajectory:
        """An empty trajectory for these robots and the clock."""
        return Trajectory(self._size)

    def plan(self, origin: Floats, trajectory: Trajectory) -> bool:
        """Fill `trajectory` for these robots, `origin` as in `_Trajectories.plan`; whether Ruckig could."""
        q, qd, qdd, target = origin[:, :-1].reshape(len(origin), 4, self._n).swapaxes(0, 1)
        self._brake(origin[:, -1] != 0)
        # As lists: Ruckig's binding reads an array number by number, in three times the time.
        self._in.current_position = [*q.ravel().tolist(), 0.0]
        self._in.current_velocity = [*self._inside(qd, qdd).ravel().tolist(), 0.0]
        self._in.current_acceleration = [*qdd.ravel().tolist(), 0.0]
        if not every(self._braking):  # a stop has no target
            self._aim(target.ravel().tolist())
        try:
            self._otg.calculate(self._in, trajectory)
        except RuckigError:
            return False
        return True

    def _aim(self, target: list[float]) -> None:
        self._in.target_position = [*target, 2 * self._longest]

    def _brake(self, braking: Bools) -> None:
        """Choose for each robot: speed to zero, or position to a target."""
        if every(braking == self._braking):
            return
        self._braking[:] = braking
        kinds = [ControlInterface.Velocity if b else ControlInterface.Position for b in braking]
        of_joints = [kind for kind in kinds for _ in range(self._n)]
        self._in.per_dof_control_interface = [*of_joints, ControlInterface.Position]

    def _inside(self, qd: Floats, qdd: Floats) -> Floats:
        """Speeds moved off the limit where a target is followed; a stop knows no limit of speed."""
        if every(self._braking):
            return qd
        bound = qd + qdd * np.abs(qdd) / self._twice_jerk
        edge = (np.abs(np.abs(bound) - self._qd_max) < EDGE) & ~self._braking[:, None]
        return np.where(edge, qd - np.sign(bound) * EDGE, qd) if some(edge) else qd


def _longest(spec: RobotSpec) -> float:
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


def _setpoint(x: Floats) -> Setpoint:
    return Setpoint(q=x[:, 0], qd=x[:, 1], qdd=x[:, 2])


def _each(rows: slice) -> list[slice]:
    return [slice(row, row + 1) for row in range(rows.start, rows.stop)]
