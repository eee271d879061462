"""Whether a setpoint may be sent: the last word before the supervisor.

Pure: (state, setpoint) → verdict, by the nominal model in Pinocchio. It never edits a number and knows neither
policy nor smoother. Beside the setpoint it checks the stop that would begin there: its first step, the pose where it
ends, and tool and collisions in its midst. What lies between is not looked at: the margins are for that.
"""

import numpy as np

from deploy.flags import every
from deploy.state import Bools, Floats, Ints, Reason, Setpoint, State, Verdict
from robots.model_pinocchio import Fleet, torque_max
from robots.spec import RobotSpec

TOLERANCE = 1e-6
"""Relative slack on speed: Ruckig meets its limits exactly, up to rounding."""

ANY = float(np.finfo(np.float64).max)
"""The largest finite number: as a bound it refuses only what is not finite."""


class Safety:
    """Every check on every tick for every robot, two points of each in one call."""

    def __init__(self, spec: RobotSpec, fleet: Fleet) -> None:
        """Read the limits.

        Args:
            spec: the robot.
            fleet: its nominal model, 2B robots wide, with collisions.
        """
        self._fleet, self._on_the_way = fleet, fleet.of(-(-fleet.robots // 2))
        margins, space = spec.margins, spec.workspace
        self._centre = np.array(space.centre)
        self._twice_jerk = 2 * spec.joint_array("qddd_max")
        low, high = spec.joint_array("q_min"), spec.joint_array("q_max")
        soft = low + margins.q_soft_rad, high - margins.q_soft_rad
        qd_max = margins.speed * spec.joint_array("qd_max") * (1 + TOLERANCE)
        tau_max = margins.tau * torque_max(spec)
        # Ages are whole ticks but for rounding: half a tick keeps a limit that is one of them in its place.
        stale_s, lost_s = margins.stale_s + spec.dt / 2, margins.lost_s + spec.dt / 2
        anything = np.full(spec.n, ANY)
        clear = (
            (0.0, 0.0, Reason.COLLISION),
            (space.z_min + margins.workspace_m, ANY, Reason.WORKSPACE),
            (0.0, (space.radius_max - margins.workspace_m) ** 2, Reason.WORKSPACE),
        )
        self._state_and_midst = _Bounds(
            self._on_the_way.robots,
            (low, high, Reason.OUTSIDE),
            (-anything, anything, Reason.NOT_FINITE),
            (*_within(np.full(spec.n, margins.tracking_rad)), Reason.TRACKING),
            (-anything, spec.motor_array("housing_max_c"), Reason.HEAT),
            (-anything, spec.motor_array("winding_max_c"), Reason.HEAT),
            (-ANY, stale_s, Reason.STALE),
            (-ANY, lost_s, Reason.LOST),
            *clear,
        )
        pose = (*soft, Reason.POSITION), (margins.singularity, ANY, Reason.SINGULARITY), *clear
        self._pose = _Bounds(fleet.robots, *pose)
        self._plan = _Bounds(
            fleet.robots,
            (*soft, Reason.POSITION),
            (*_within(qd_max), Reason.VELOCITY),
            (*_within(qd_max), Reason.VELOCITY),
            (*_within(tau_max), Reason.TORQUE),
            *pose,
            (0.0, (margins.speed * space.tool_speed_max) ** 2, Reason.TOOL_SPEED),
        )

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
        tau = self._fleet.torque(q, qd, qdd).copy()
        # A drive that is folded back has less to give than its range.
        asked = tau if every(state.fold == 1.0) else np.concatenate((tau[:robots] / state.fold, tau[robots:]))
        poses = self._place(np.concatenate((setpoint.q, q_rest)))
        self._on_the_way.glance(q_midst)
        # A stop first lets the acceleration run out, and the speed that it gains until then counts.
        qd_peak = qd + qdd * np.abs(qdd) / self._twice_jerk
        speeds = self._fleet.tool_velocity(
            np.concatenate((setpoint.qd, qd_peak[:robots])), of=slice(0, robots)
        )
        points = self._plan.reasons(q, qd, qd_peak, asked, *poses, np.vecdot(speeds, speeds)[:, None])
        midst, lag = self._clear(self._on_the_way), sent.q - state.q
        heat = state.temperature, state.hottest
        reason = self._state_and_midst.reasons(state.q, state.qd, lag, *heat, age, age, *midst)
        reason |= points[:robots] | points[robots:]
        return Verdict(reason=reason, tau=tau[:robots], tau_ahead=tau[robots:])

    def check_poses(self, q: Floats) -> Ints:
        """(R,) what speaks against being at `q` (R, n) rad; R is the width of the fleet."""
        return self._pose.reasons(*self._place(q))

    def _place(self, q: Floats) -> tuple[Floats | Bools, ...]:
        """Place the fleet at (R, n) rad and read the columns of a pose."""
        self._fleet.place(q)
        return q, self._fleet.manipulability()[:, None], *self._clear(self._fleet)

    def _clear(self, fleet: Fleet) -> tuple[Floats | Bools, ...]:
        """Columns of where a fleet is: collision, m above the world's origin, m² from the workspace's centre."""
        tool = fleet.tool_position
        arm = tool - self._centre
        return fleet.colliding[:, None], tool[:, 2:], np.vecdot(arm, arm)[:, None]


class _Bounds:
    """Rows of numbers, each column with the range that it must be in and the reason for which it is refused outside."""

    def __init__(self, rows: int, *columns: tuple[Floats | float, Floats | float, Reason]) -> None:
        parts = [np.broadcast_arrays(*(np.atleast_1d(value) for value in column)) for column in columns]
        low, high, self._reason = (np.concatenate(part) for part in zip(*parts, strict=True))
        self._low, self._high = np.tile(low, (rows, 1)), np.tile(high, (rows, 1))
        # A reading that is no number is as bad as one beyond its bound; elsewhere it is a fault of its own.
        reading = self._reason & (Reason.HEAT | Reason.STALE | Reason.LOST) != 0
        self._unknown = np.where(reading, self._reason, Reason.NOT_FINITE)

    def reasons(self, *values: Floats | Bools) -> Ints:
        """(R,) what speaks against each row of values (R, ...), side by side in the order of the columns."""
        x = np.concatenate(values, axis=1)
        inside = (x >= self._low) & (x <= self._high)
        if every(inside):
            return np.zeros(len(x), dtype=np.int64)
        reason = np.where(np.isfinite(x), self._reason, self._unknown)
        return np.asarray(np.bitwise_or.reduce(np.where(inside, 0, reason), axis=1))


def _within(limit: Floats) -> tuple[Floats, Floats]:
    return -limit, limit
