"""Jerk-limited setpoints, towards a target angle or at a target speed, or into a stop.

A robot that is where it was planned to be, for a target that has not changed, stays on its trajectory; any other gets
a new one.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deploy.masks import all_true, any_true
from deploy.motion.drive_modes import position_drives
from deploy.motion.ruckig_planner import RuckigPlanner, VelocityPlanner, horizon_s
from deploy.motion.trajectories import StopTrajectories, TrackingTrajectories
from deploy.stage import Stage
from deploy.state import DriveMode, Setpoint, State, Stop
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec

REST = 1e-6
"""rad/s and rad/s². Below it is rounding, which Ruckig may take many periods to bring to nothing."""


class Smoother(Stage):
    """The last SENT setpoint of B robots, the trajectories that they are on, and the stops that could begin.

    Attributes:
        q, qd, qdd: (B, n) rad, rad/s, rad/s², the last setpoint sent.
        origin: (B, 4n + 2) where each robot's trajectory began, and its inputs then: q, qd, qdd, target, speed scale,
            stopping.
        expected: (B, 4n + 2) the same of now, if all went as planned: a robot that differs gets a new trajectory.
        speed_share: (B,) share of its speed and acceleration that a robot may use to follow a target; an input. One
            that falls while the robot brakes carries it beyond its target: it should fall in small steps.
        q_min, q_max: (B, n) rad, to which targets are clamped.
        age: (B,) ticks since `origin`, less those at rest after a stop.
        drive: how drives follow setpoints on the way to a target.
    """

    carried: ClassVar[tuple[str, ...]] = ("q", "qd", "qdd", "origin", "expected", "age")
    planner: ClassVar[type[RuckigPlanner]] = RuckigPlanner

    def __init__(self, spec: RobotSpec, robots: int, drive: DriveMode | None = None) -> None:
        """Begin at rest at 0 rad; `drive` None: position drives with the robot's own gains."""
        shape, self.drive = (robots, spec.n), drive or position_drives(spec, robots)
        self._sent_drive: DriveMode | None = self.drive
        self.q, self.qd, self.qdd = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self.origin = np.full((robots, 4 * spec.n + 2), np.nan)
        self.expected, self.age = self.origin.copy(), np.zeros(robots, dtype=np.int64)
        margin = spec.margins.q_target_rad
        self.q_min = np.tile(spec.joint_array("q_min") + margin, (robots, 1))
        self.q_max = np.tile(spec.joint_array("q_max") - margin, (robots, 1))
        self._tracking = TrackingTrajectories(spec, robots, self.planner)
        self._stops = StopTrajectories(spec, robots)
        self._age_max = round(horizon_s(spec) / spec.dt)
        self.speed_share, self._full = np.ones(robots), np.ones((robots, 1))

    @property
    def target_at_rest(self) -> Floats:
        """(B, n) target under which robots at rest stay where they are."""
        return self.q

    def plan(self, target: Floats, stopping: Bools, state: State) -> Setpoint:
        """Return the next setpoint of every robot, as `next`; the estimate is of no use where drives follow angles."""
        del state
        return self.next(target, stopping)

    def next(self, target: Floats, stopping: Bools) -> Setpoint:
        """Return one step from the last sent setpoint: towards a target, or towards rest; NaN where Ruckig has no plan.

        Robots `stopping` (B,) brake instead of following their targets (B, n).
        """
        target, stops = self._limited(target), stopping[:, None]
        speed_share = self.speed_share
        if any_true(stopping):
            target[stopping] = 0.0  # unused: it must not count as a new target
            self.age -= stopping & self.at_rest  # or rounding would creep on
            speed_share = np.where(
                stopping, 1.0, speed_share
            )  # a stop has its full limits, as it was checked
        self.age += 1
        self._replan(np.concatenate((self.q, self.qd, self.qdd, target, speed_share[:, None], stops), axis=1))
        planned = self._tracking.at(self.age)
        self.expected[:, : planned[0].size] = planned.reshape(len(planned), -1)
        return self._setpoint(planned)

    def _limited(self, target: Floats) -> Floats:
        """Return target angles inside the working range less its margin."""
        return np.minimum(np.maximum(target, self.q_min), self.q_max)

    def _replan(self, now: Floats) -> None:
        """Plan again for robots that are not where they were expected, have new inputs, or were on one for too long."""
        as_expected = now == self.expected
        old = self.age >= self._age_max
        if all_true(as_expected) and not any_true(old):
            return
        changed = ~as_expected.all(axis=1) | old
        self.origin[changed], self.age[changed] = now[changed], 1
        self.expected[:] = now
        self._tracking.plan(self.origin, changed)

    def brake(self, start: Setpoint) -> Stop:
        """Return the stop that would begin at `start`."""
        x = self._stops.points(
            np.concatenate((start.q, start.qd, start.qdd, start.q, self._full, self._full), axis=1)
        ).swapaxes(0, 1)
        ahead = Setpoint(q=x[0], qd=x[1], qdd=x[2], drive=self.drive)
        return Stop(ahead, q=x[3:-1:3], qd=x[4:-1:3], qdd=x[5:-1:3], q_rest=x[-1])

    def _setpoint(self, x: Floats) -> Setpoint:
        return Setpoint(q=x[:, 0], qd=x[:, 1], qdd=x[:, 2], drive=self.drive)

    def commit(self, sent: Setpoint) -> None:
        """Remember what was sent."""
        self.q[:], self.qd[:], self.qdd[:], self._sent_drive = sent.q, sent.qd, sent.qdd, sent.drive

    def hold(self, ids: Bools, q: Floats) -> None:
        """Put robots at rest where `ids` (B,) holds at `q` (B, n) rad."""
        self.q[ids], self.qd[ids], self.qdd[ids] = q[ids], 0.0, 0.0

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back and plan their trajectories again."""
        super().restore(arrays)
        self._tracking.plan(self.origin)

    @property
    def sent(self) -> Setpoint:
        """The last setpoint sent."""
        return Setpoint(q=self.q, qd=self.qd, qdd=self.qdd, drive=self._sent_drive)

    @property
    def at_rest(self) -> Bools:
        """(B,) robots whose last sent setpoint is at rest."""
        return np.asarray(np.maximum(np.abs(self.qd), np.abs(self.qdd)).max(axis=1) < REST)

    @property
    def stopped(self) -> Bools:
        """(B,) robots at rest whose power may be cut."""
        return self.at_rest


class VelocitySmoother(Smoother):
    """Smoother of robots in velocity mode: targets are speeds, rad/s; the planner keeps angles in their range."""

    planner = VelocityPlanner

    def __init__(self, spec: RobotSpec, robots: int, drive: DriveMode | None = None) -> None:
        super().__init__(spec, robots, drive)
        self._still = np.zeros((robots, spec.n))

    @property
    def target_at_rest(self) -> Floats:
        """(B, n) rad/s."""
        return self._still

    def _limited(self, target: Floats) -> Floats:
        """Return a copy: the planner limits speeds."""
        return target.copy()
