"""Jerk-limited trajectories with Ruckig; a stop is one of them.

One Ruckig instance serves the joints of `BLOCK` robots in one call; more robots take their turns in it, and what it
works with stays in the cache. `reset()` before every update makes each joint's result independent of its neighbours
and of the past, so a resumed run repeats the same bits.
"""

import numpy as np
from ruckig import ControlInterface, InputParameter, OutputParameter, Ruckig, RuckigError, Synchronization

from deploy.stage import Stage
from deploy.state import Bools, Floats, Setpoint
from robots.blocks import turns
from robots.spec import RobotSpec

EDGE = 1e-8
"""rad/s. Ruckig may replan badly when the speed it is bound to reach is this near the limit; the state is moved in."""

NUDGE = 1e-9
"""rad. How far a target is moved where Ruckig has no plan for the exact one."""

REST = 1e-6
"""rad/s and rad/s². What is left below is rounding, which Ruckig may take many periods to bring to nothing."""


class Smoother(Stage):
    """The last SENT setpoint of B robots, and the first step of the ways on from there."""

    carried = ("q", "qd", "qdd")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Build both Ruckig instances: one for what comes next, one for stops."""
        shape = (robots, spec.n)
        self.q, self.qd, self.qdd = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        margin = spec.margins.q_target_rad
        self._q_min = np.tile(spec.joint_array("q_min") + margin, (robots, 1))
        self._q_max = np.tile(spec.joint_array("q_max") - margin, (robots, 1))
        self._next, self._stop = _Planner(spec, robots), _Planner(spec, robots)
        self._everybody = np.ones(robots, dtype=bool)

    def next(self, q_target: Floats, stopping: Bools) -> Setpoint:
        """One step from the last sent setpoint: towards a target, or towards rest.

        Args:
            q_target: (B, n) rad, clamped here to the working range less its margin.
            stopping: (B,) robots that brake instead.
        """
        return self._next.step(
            self.sent, np.minimum(np.maximum(q_target, self._q_min), self._q_max), stopping
        )

    def brake(self, start: Setpoint) -> tuple[Setpoint, Floats]:
        """A stop that would begin at `start`: its first step, and where (B, n) rad it would come to rest."""
        rest = np.empty_like(start.q)
        return self._stop.step(start, start.q, self._everybody, rest=rest), rest

    def commit(self, sent: Setpoint) -> None:
        """Remember what was sent."""
        self.q[:], self.qd[:], self.qdd[:] = sent.q, sent.qd, sent.qdd

    def hold(self, ids: Bools, q: Floats) -> None:
        """Rest robots where `ids` (B,) holds at `q` (B, n) rad."""
        self.q[ids], self.qd[ids], self.qdd[ids] = q[ids], 0.0, 0.0

    @property
    def sent(self) -> Setpoint:
        """The last setpoint sent."""
        return Setpoint(q=self.q, qd=self.qd, qdd=self.qdd)

    @property
    def at_rest(self) -> Bools:
        """(B,) whether the last sent setpoint stands still."""
        return np.asarray(np.maximum(np.abs(self.qd), np.abs(self.qdd)).max(axis=1) < REST)


class _Planner:
    """One Ruckig instance."""

    def __init__(self, spec: RobotSpec, robots: int, *, alone: bool = False) -> None:
        self._turns = turns(robots)
        width = self._turns[0].stop
        self._shape, size = (width, spec.n), width * spec.n
        self._otg, self._in, self._out = (
            Ruckig(size, spec.dt),
            InputParameter(size),
            OutputParameter(size),
        )
        self._qd_max = np.tile(spec.margins.speed * spec.joint_array("qd_max"), (width, 1))
        self._twice_jerk = np.tile(2 * spec.joint_array("qddd_max"), (width, 1))
        self._in.max_velocity = self._qd_max.ravel()
        self._in.max_acceleration = np.tile(spec.joint_array("qdd_max"), width)
        self._in.max_jerk = self._twice_jerk.ravel() / 2
        self._in.synchronization = Synchronization.No
        self._in.per_dof_control_interface = [ControlInterface.Position] * size
        self._braking, self._following = np.zeros(width, dtype=bool), np.ones(self._shape, dtype=bool)
        self._solo = None if alone else _Planner(spec, 1, alone=True)

    def step(
        self, start: Setpoint, target: Floats, braking: Bools, *, rest: Floats | None = None
    ) -> Setpoint:
        """One control period along the fastest trajectories; NaN in the rows that have none.

        Args:
            start: where they begin.
            target: (B, n) rad, where they end at rest.
            braking: (B,) robots that come to rest wherever that is soonest instead.
            rest: (B, n), filled with where all of them end.
        """
        x = np.empty((3, *start.q.shape))
        for rows in self._turns:
            self._brake(braking[rows])
            x[:, rows], ends = self._turn(start.q[rows], start.qd[rows], start.qdd[rows], target[rows])
            if rest is not None:
                rest[rows] = self._ends() if ends is None else ends
        return Setpoint(q=x[0], qd=x[1], qdd=x[2])

    def _brake(self, braking: Bools) -> None:
        """Choose for each robot: speed to zero, or position to a target."""
        if (braking == self._braking).all():
            return
        self._braking[:] = braking
        self._following[:] = ~braking[:, None]
        kinds = [ControlInterface.Velocity if b else ControlInterface.Position for b in braking]
        self._in.per_dof_control_interface = [kind for kind in kinds for _ in range(self._shape[1])]

    def _turn(self, q: Floats, qd: Floats, qdd: Floats, target: Floats) -> tuple[Floats, Floats | None]:
        """Angles, speeds and accelerations (3, width, n) after one period, and the ends where Ruckig has none."""
        # As lists: Ruckig's binding reads an array number by number, in three times the time.
        self._in.current_position = q.ravel().tolist()
        self._in.current_velocity = self._inside(qd, qdd).ravel().tolist()
        self._in.current_acceleration = qdd.ravel().tolist()
        self._in.target_position = target.ravel().tolist()
        self._otg.reset()
        try:
            self._otg.update(self._in, self._out)
        except RuckigError:
            return self._one_by_one(q, qd, qdd, target)
        out = np.array((self._out.new_position, self._out.new_velocity, self._out.new_acceleration))
        return out.reshape(3, *self._shape), None

    def _ends(self) -> Floats:
        """(width, n) rad, where the trajectories of the last turn end."""
        trajectory = self._out.trajectory
        return np.array(trajectory.at_time(trajectory.duration)[0]).reshape(self._shape)

    def _inside(self, qd: Floats, qdd: Floats) -> Floats:
        """Speeds moved off the limit where a target is followed; a stop knows no limit of speed."""
        if self._braking.all():
            return qd
        bound = qd + qdd * np.abs(qdd) / self._twice_jerk
        edge = (np.abs(np.abs(bound) - self._qd_max) < EDGE) & self._following
        return np.where(edge, qd - np.sign(bound) * EDGE, qd) if np.count_nonzero(edge) else qd

    def _one_by_one(self, q: Floats, qd: Floats, qdd: Floats, target: Floats) -> tuple[Floats, Floats]:
        """Ruckig fails for the whole call when one joint has no solution: find it, spare the others.

        Where two shapes of profile meet exactly, as at a distance of 2a³/j², it finds neither: a rounded acceleration
        or a target next to it cures the failures seen. A robot that stays without a plan gets NaN, which safety
        refuses.
        """
        x, ends = np.full((3, *q.shape), np.nan), np.full(q.shape, np.nan)
        if self._solo is None:
            return x, ends
        for row in range(len(q)):
            one = slice(row, row + 1)
            braking, end = self._braking[one], ends[one]
            plan = self._solo.step(
                Setpoint(q=q[one], qd=qd[one], qdd=qdd[one]), target[one], braking, rest=end
            )
            if np.isnan(plan.q).any():
                start = Setpoint(q=q[one], qd=qd[one], qdd=qdd[one].round(9))
                plan = self._solo.step(start, target[one] + NUDGE, braking, rest=end)
            x[0, one], x[1, one], x[2, one] = plan.q, plan.qd, plan.qdd
        return x, ends
