"""One Ruckig instance that plans the joints of several robots in one call."""

from typing import ClassVar

import numpy as np
from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from deploy.masks import all_true, any_true
from robots.arrays import Bools, Floats
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

EDGE = 1e-8
"""rad/s. Ruckig may plan badly when the speed it is bound to reach is this near the limit: it is moved inside."""

RENEW_S = 1.0
"""s. No trajectory is read later than this, so that rounding at its end cannot add up to a drift; only where a stop
may take longer than this, it is that long."""

SPEED_MIN = 1e-3
"""Share of a joint's speed limit below which a target speed counts as 0."""

FAR_S = 1000.0
"""s. A target that takes longer at the limit of speed is moved nearer: Ruckig has no plan for more than two hours, and
no trajectory is read that late."""


def horizon_s(spec: RobotSpec) -> float:
    """Return s after which no trajectory is read any more."""
    return max(RENEW_S, spec.stop_s)


class RuckigPlanner:
    """Planner of R robots: targets are angles.

    After the joints of the robots comes a clock: a joint that moves for longer than any trajectory is read. Beyond the
    end of the last joint Ruckig computes in another order, with other last bits; with the clock that never comes, and
    no robot's bits depend on when its neighbours arrive.
    """

    mode: ClassVar[ControlMode] = ControlMode.POSITION

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Set the limits of robot.toml, speed less its margin."""
        self._n, self._size = spec.n, robots * spec.n + 1
        self._otg, self._in = Ruckig(self._size, spec.dt), InputParameter(self._size)
        self._qd_max = np.tile(spec.margins.of(self.mode).speed * spec.joint_array("qd_max"), (robots, 1))
        self._twice_jerk = np.tile(2 * spec.joint_array("qddd_max"), (robots, 1))
        self._qdd_max = np.tile(spec.joint_array("qdd_max"), (robots, 1))
        self._in.max_jerk = [*self._twice_jerk.ravel() / 2, 1.0]
        self._in.synchronization = Synchronization.No
        self._in.per_dof_control_interface = [ControlInterface.Position] * self._size
        self._stopping = np.zeros(robots, dtype=bool)
        self._set_limits(np.ones(robots))
        # Ruckig's inputs q, qd, qdd and target, with the clock at the end of each.
        self._inputs = np.zeros((4, self._size))
        self._inputs[3, -1] = 2 * horizon_s(spec)
        self._joints = self._inputs[:, :-1].reshape(4, robots, spec.n)

    def empty_trajectory(self) -> Trajectory:
        """Return memory for a trajectory of these robots and the clock."""
        return Trajectory(self._size)

    def plan(self, origin: Floats, trajectory: Trajectory) -> bool:
        """Fill `trajectory`, `origin` as in `TrackingTrajectories.plan`; return False where Ruckig has no plan."""
        self._joints[:] = origin[:, :-2].reshape(len(origin), 4, self._n).swapaxes(0, 1)
        self._prepare(origin[:, -2], origin[:, -1] != 0)
        if not all_true(self._stopping):  # a stop has no target, nor a limit of speed
            self._move_nearer()
            self._move_inside()
        # As lists: Ruckig's binding reads an array number by number, in three times the time.
        q, qd, qdd, target = self._inputs.tolist()
        self._in.current_position, self._in.current_velocity, self._in.current_acceleration = q, qd, qdd
        self._in.target_position = target
        try:
            self._otg.calculate(self._in, trajectory)
        except (RuckigError, ValueError):  # ValueError: a result without a name, of a motion of hours
            return False
        return True

    def _prepare(self, speed_share: Floats, stopping: Bools) -> None:
        """Set limits and interfaces for the inputs."""
        self._set_stopping(stopping)
        if not all_true(speed_share == self._speed_share):
            self._set_limits(speed_share)

    def _set_stopping(self, stopping: Bools) -> None:
        """Choose for each robot: speed to zero, or position to a target."""
        if all_true(stopping == self._stopping):
            return
        self._stopping[:] = stopping
        kinds = [ControlInterface.Velocity if stops else ControlInterface.Position for stops in stopping]
        by_joint = [kind for kind in kinds for _ in range(self._n)]
        self._in.per_dof_control_interface = [*by_joint, ControlInterface.Position]

    def _set_limits(self, speed_share: Floats) -> None:
        self._speed_share = speed_share.copy()
        self._speed = self._qd_max * speed_share[:, None]
        self._in.max_velocity = [*self._speed.ravel().tolist(), 1.0]
        self._in.max_acceleration = [*(self._qdd_max * speed_share[:, None]).ravel().tolist(), 1.0]

    def _move_nearer(self) -> None:
        """Move targets that are too far to be reached in `FAR_S`."""
        q, _, _, target = self._joints
        far = FAR_S * self._speed
        np.clip(target, q - far, q + far, out=target)

    def _move_inside(self) -> None:
        """Move speeds that end near the limit inside, where a target is followed."""
        _, qd, qdd, _ = self._joints
        peak = qd + qdd * np.abs(qdd) / self._twice_jerk
        edge = (np.abs(np.abs(peak) - self._speed) < EDGE) & ~self._stopping[:, None]
        if any_true(edge):
            qd -= np.where(edge, np.sign(peak) * EDGE, 0.0)


class VelocityPlanner(RuckigPlanner):
    """Planner of R robots: targets are speeds.

    A joint goes towards the end of its range at the speed that is asked for: Ruckig's position interface, with that
    speed as its limit, brakes in time to rest there. Its velocity interface knows no end of the range: it serves joints
    that have none, and those that are to stand.
    """

    mode = ControlMode.VELOCITY

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        """Set the limits of robot.toml, speed and range less their margins."""
        super().__init__(spec, robots)
        margin = spec.margins.q_target_rad
        self._low, self._high = spec.joint_array("q_min") + margin, spec.joint_array("q_max") - margin

    def _prepare(self, speed_share: Floats, stopping: Bools) -> None:
        """Turn target speeds into angles, limits of speed and interfaces."""
        self._stopping[:] = stopping
        limit = self._qd_max * speed_share[:, None]
        speed, target = np.clip(self._joints[3], -limit, limit), self._joints[3]
        end = np.where(speed > 0, self._high, self._low)
        travels = (np.abs(speed) > SPEED_MIN * self._qd_max) & ~stopping[:, None]
        to_end = travels & np.isfinite(end)
        target[:] = np.where(to_end, end, 0.0)
        self._speed = np.where(to_end, np.abs(speed), limit)
        self._in.target_velocity = [*np.where(travels & ~to_end, speed, 0.0).ravel().tolist(), 0.0]
        self._in.max_velocity = [*self._speed.ravel().tolist(), 1.0]
        self._in.max_acceleration = [*(self._qdd_max * speed_share[:, None]).ravel().tolist(), 1.0]
        kinds = (ControlInterface.Velocity, ControlInterface.Position)
        self._in.per_dof_control_interface = [*(kinds[each] for each in to_end.ravel().tolist()), kinds[1]]
