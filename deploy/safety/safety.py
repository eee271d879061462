"""Whether a setpoint may be sent: the last word before the supervisor.

Pure: (state, setpoint) → verdict, by the nominal model in Pinocchio. It never edits a number and knows neither
policy nor smoother. Beside the setpoint it checks the stop that would begin there: its first step, the pose where it
ends, and tool and collisions in its midst. What lies between is not looked at: the margins are for that.
"""

import numpy as np

from deploy.masks import all_true
from deploy.motion.drive_law import Effort, Feedforward
from deploy.state import Reason, Setpoint, State, Verdict
from robots.arrays import Bools, Floats, Ints
from robots.models.fleet import Fleet
from robots.spec import RobotSpec

TOLERANCE = 1e-6
"""Relative slack on speed: Ruckig meets its limits exactly, up to rounding."""

SAME_GAP_M = 1e-4
"""m by which two ways to measure the gap between shapes may differ."""

ANY = float(np.finfo(np.float64).max)
"""The largest finite number: as a bound it refuses only what is not finite."""


class Safety:
    """Every check on every tick for every robot, two points of each in one call."""

    def __init__(self, spec: RobotSpec, fleet: Fleet, effort: Effort | None = None) -> None:
        """Read the limits.

        Args:
            spec: the robot.
            fleet: its nominal model, 2B robots wide, with collisions.
            effort: the law of its drives; by default they are stiff.
        """
        self._fleet, self._on_the_way = fleet, fleet.of(-(-fleet.robots // 2))
        self._effort, self._tooling = effort or Feedforward(spec, fleet), spec.tool
        self._apart = (spec.margins.collision_m or 0.0) + SAME_GAP_M
        self._space, self._singularity = spec.workspace, spec.margins.singularity
        self.twice_jerk = 2 * spec.joint_array("qddd_max")
        self._state_and_midst = _Bounds(self._on_the_way.robots, spec.n, *_of_state(spec), *_of_place(spec))
        self._pose = _Bounds(fleet.robots, spec.n, *_of_pose(spec))
        motion = _of_motion(spec, self._effort.bound)
        self._plan = _Bounds(fleet.robots, spec.n, *motion, *_of_pose(spec), *_of_tool_speed(spec))
        if spec.workspace:
            self._centre = np.array(spec.workspace.centre)

    # A setpoint without a number is refused by its own check; nobody else need complain.
    @np.errstate(invalid="ignore", over="ignore")
    def step(
        self,
        state: State,
        sent: Setpoint,
        setpoint: Setpoint,
        ahead: Setpoint,
        q_midst: Floats,
        q_rest: Floats,
    ) -> Verdict:
        """Judge one setpoint for each robot.

        Args:
            state: what the estimator believes.
            sent: the last setpoint sent, which the drives follow now.
            setpoint: what would be sent next.
            ahead: the first step of the stop that would begin at `setpoint`.
            q_midst: (B, n) rad, a pose in the midst of that stop.
            q_rest: (B, n) rad, where it would end.
        """
        robots, age = len(q_rest), state.age[:, None]
        q, qd, qdd = (np.concatenate(pair) for pair in zip(setpoint, ahead, strict=True))
        tau = self._effort.torque(state, q, qd, qdd).copy()
        # A drive that is folded back has less to give than its range.
        asked = (
            tau if all_true(state.fold == 1.0) else np.concatenate((tau[:robots] / state.fold, tau[robots:]))
        )
        poses = begin, on_the_way, end = self._effort.poses(state, setpoint.q, q_midst, q_rest)
        places = self._place(np.concatenate((begin, end)))
        self._on_the_way.glance(on_the_way)
        # A stop first lets the acceleration run out, and the speed that it gains until then counts.
        qd_peak = qd + qdd * np.abs(qdd) / self.twice_jerk
        speeds = self._tool_speeds(np.concatenate((setpoint.qd, qd_peak[:robots])))
        q_ends = np.concatenate((setpoint.q, q_rest))
        plan: Floats = np.concatenate((q, qd, qd_peak, asked, q_ends, *places, *speeds), axis=1)
        midst, lag = self._clear(self._on_the_way), sent.q - state.q
        believed = state.q, state.qd, lag, state.temperature, state.hottest, age, age
        upright = () if state.base is None else (-state.base.gravity[:, 2:],)
        belief: Floats = np.concatenate((*believed, *upright, *midst), axis=1)
        points, reason = self._plan.reasons(plan), self._state_and_midst.reasons(belief)
        reason |= points[:robots] | points[robots:]
        read = plan, belief
        return Verdict(reason=reason, tau=tau[:robots], tau_ahead=tau[robots:], poses=poses, read=read)

    def check_poses(self, q: Floats) -> Ints:
        """(R,) what speaks against being at `q` (R, n) rad; R is the width of the fleet."""
        return self._pose.reasons(np.concatenate((q, *self._place(q)), axis=1))

    def joints(self, verdict: Verdict, robot: int, reason: Reason) -> Bools:
        """(n,) joints of a robot for which a verdict gave one reason; none where it is about something else."""
        plan, belief = verdict.read
        rows = plan[robot], plan[robot + len(belief)]
        of_plan = self._plan.joints(rows[0], reason) | self._plan.joints(rows[1], reason)
        return of_plan | self._state_and_midst.joints(belief[robot], reason)

    def meeting(self, verdict: Verdict, robot: int) -> tuple[str, ...]:
        """Two shapes of a robot that come too near to each other where a verdict looked; none where none do.

        A pose that is no numbers is refused as a collision, too: no shapes are to blame for that.
        """
        gap, *names = self._fleet.nearest(np.stack([pose[robot] for pose in verdict.poses]))
        return tuple(names) if gap < self._apart else ()

    def _place(self, q: Floats) -> tuple[Floats | Bools, ...]:
        """Place the fleet at (R, n) rad and read the columns of where it is."""
        if not self._tooling:
            self._fleet.glance(q)
            return self._clear(self._fleet)
        self._fleet.place(q)
        measure = (self._fleet.manipulability()[:, None],) if self._singularity is not None else ()
        return *measure, *self._clear(self._fleet)

    def _clear(self, fleet: Fleet) -> tuple[Floats | Bools, ...]:
        """Columns of where a fleet is: collision, m above the world's origin, m² from the workspace's centre."""
        if not self._space:
            return (fleet.colliding[:, None],)
        tool = fleet.tool_position
        arm = tool - self._centre
        return fleet.colliding[:, None], tool[:, 2:], np.vecdot(arm, arm)[:, None]

    def _tool_speeds(self, qd: Floats) -> tuple[Floats, ...]:
        """m²/s², a column of squared speeds of the tool at the first half's poses, for qd (R, n) rad/s."""
        if not self._space:
            return ()
        speeds = self._fleet.tool_velocity(qd, of=slice(0, self._on_the_way.robots))
        return (np.vecdot(speeds, speeds)[:, None],)


Column = tuple[Floats | float, Floats | float, Reason]
"""Least, most, and the reason for which what lies outside is refused; of (n,) columns, or of one."""


def _of_state(spec: RobotSpec) -> tuple[Column, ...]:
    """What is believed: q, qd, lag, temperature, hottest, age twice, and of a base the cosine of its tilt."""
    margins, anything = spec.margins, np.full(spec.n, ANY)
    # Ages are whole ticks but for rounding: half a tick keeps a limit that is one of them in its place.
    stale_s, lost_s = margins.stale_s + spec.dt / 2, margins.lost_s + spec.dt / 2
    columns: tuple[Column, ...] = (
        (spec.joint_array("q_min"), spec.joint_array("q_max"), Reason.OUTSIDE),
        (-anything, anything, Reason.NOT_FINITE),
        (*_within(np.full(spec.n, margins.tracking_rad)), Reason.TRACKING),
        (-anything, spec.motor_array("housing_max_c"), Reason.HEAT),
        (-anything, spec.motor_array("winding_max_c"), Reason.HEAT),
        (-ANY, stale_s, Reason.STALE),
        (-ANY, lost_s, Reason.LOST),
    )
    return (*columns, (np.cos(spec.base.tilt_max_rad), ANY, Reason.FALLEN)) if spec.base else columns


def _of_place(spec: RobotSpec) -> tuple[Column, ...]:
    """Where a robot is: collision, and of a tool its height and squared distance from the workspace's centre."""
    collision, space, margin = (0.0, 0.0, Reason.COLLISION), spec.workspace, spec.margins.workspace_m
    if space is None or margin is None:
        return (collision,)
    return (
        collision,
        (space.z_min + margin, ANY, Reason.WORKSPACE),
        (0.0, (space.radius_max - margin) ** 2, Reason.WORKSPACE),
    )


def _soft(spec: RobotSpec) -> Column:
    margin = spec.margins.q_soft_rad
    return spec.joint_array("q_min") + margin, spec.joint_array("q_max") - margin, Reason.POSITION


def _of_pose(spec: RobotSpec) -> tuple[Column, ...]:
    """Joint angles, manipulability of a tool, and the place."""
    least = spec.margins.singularity
    measure: tuple[Column, ...] = ((least, ANY, Reason.SINGULARITY),) if least is not None else ()
    return (_soft(spec), *measure, *_of_place(spec))


def _of_motion(spec: RobotSpec, tau_max: Floats) -> tuple[Column, ...]:
    """A point of a trajectory: q, qd, the highest qd to come, tau."""
    qd_max = spec.margins.speed * spec.joint_array("qd_max") * (1 + TOLERANCE)
    speed: Column = (*_within(qd_max), Reason.VELOCITY)
    return _soft(spec), speed, speed, (*_within(np.minimum(tau_max, ANY)), Reason.TORQUE)


def _of_tool_speed(spec: RobotSpec) -> tuple[Column, ...]:
    if spec.workspace is None:
        return ()
    return ((0.0, (spec.margins.speed * spec.workspace.tool_speed_max) ** 2, Reason.TOOL_SPEED),)


class _Bounds:
    """Rows of numbers, each column with the range that it must be in and the reason for which it is refused outside."""

    def __init__(self, rows: int, n: int, *columns: Column) -> None:
        parts = [np.broadcast_arrays(*(np.atleast_1d(value) for value in column)) for column in columns]
        low, high, self._reason = (np.concatenate(part) for part in zip(*parts, strict=True))
        self._low, self._high = np.tile(low, (rows, 1)), np.tile(high, (rows, 1))
        # A reading that is no number is as bad as one beyond its bound; elsewhere it is a fault of its own.
        reading = self._reason & (Reason.HEAT | Reason.STALE | Reason.LOST) != 0
        self._unknown = np.where(reading, self._reason, Reason.NOT_FINITE)
        # Whose each column is; in a row more, what is of no joint.
        self._whose = np.concatenate([np.arange(n) if len(part[0]) == n else [n] for part in parts])
        self._n = n

    def reasons(self, x: Floats) -> Ints:
        """(R,) what speaks against each row of x (R, C)."""
        inside = (x >= self._low) & (x <= self._high)
        if all_true(inside):
            return np.zeros(len(x), dtype=np.int64)
        return np.asarray(np.bitwise_or.reduce(self._why(x, inside), axis=1))

    def joints(self, x: Floats, reason: Reason) -> Bools:
        """(n,) whose columns of one row x (C,) give a reason."""
        inside = (x >= self._low[0]) & (x <= self._high[0])
        if reason is Reason.NOT_FINITE:  # one joint's motion that is no number leaves no torque that is one
            inside |= self._reason == Reason.TORQUE
        found = np.zeros(self._n + 1, dtype=bool)
        found[self._whose[self._why(x, inside) & int(reason) != 0]] = True
        return found[: self._n]

    def _why(self, x: Floats, inside: Bools) -> Ints:
        return np.where(inside, 0, np.where(np.isfinite(x), self._reason, self._unknown))


def _within(limit: Floats) -> tuple[Floats, Floats]:
    return -limit, limit
