"""Check of a setpoint before it is sent: the last stage before the supervisor.

Pure: (state, setpoint) → verdict, by the nominal model in Pinocchio. It never edits a number and knows neither
policy nor smoother. With the setpoint it checks the stop that would begin there: its first step, moments while it
brakes and the pose where it ends. What lies between is left to the margins.
"""

import numpy as np

from deploy.masks import all_true
from deploy.motion.drive_law import DriveLaw, StiffDrives
from deploy.reasons import Reason
from deploy.safety.check import Estimate, Limits, Motion, Pose, ToolMotion
from deploy.safety.check_table import CheckTable
from deploy.safety.checks import CHECKS, Checks
from deploy.safety.plan_points import plan_points
from deploy.state import STOP_MOMENTS, Setpoint, State, Stop, Verdict
from robots.arrays import Bools, Floats, Ints
from robots.models.fleet import Fleet
from robots.models.kinematics import Kinematics
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec

GAP_TOLERANCE_M = 1e-4
"""m by which two ways to measure the gap between shapes may differ."""


class Safety:
    """All checks for all robots on every tick.

    Attributes:
        twice_jerk: (n,) rad/s³, twice the jerk of a stop.
    """

    def __init__(
        self,
        spec: RobotSpec,
        fleet: Fleet,
        drives: DriveLaw | None = None,
        checks: Checks = CHECKS,
        mode: ControlMode = ControlMode.POSITION,
    ) -> None:
        """Compute the bounds.

        Args:
            spec: the robot.
            fleet: its nominal model, 2B robots wide, with collisions and the margins of `mode`.
            drives: the law of its drives; stiff drives by default.
            checks: those that a robot has if it meets their needs.
            mode: of the drives when they follow the policy.

        Raises:
            ValueError: two checks of one name in a table, or a bound of the wrong shape.
        """
        spec, self._fleet, rows = spec.in_mode(mode), fleet, fleet.robots
        robots = -(-rows // 2)
        self._drives = drives or StiffDrives(spec, fleet)
        each = (STOP_MOMENTS + 2) * robots  # the setpoint, the moments of its stop, and its end
        poses = each * self._drives.expectations
        tool_rows = np.concatenate((np.arange(robots), np.arange((STOP_MOMENTS + 1) * robots)))
        self._tool_rows = (np.arange(0, poses, each)[:, None] + tool_rows).ravel()
        self._fleet_of_plan = fleet.resized(poses)
        self._fleet_of_estimate = fleet.resized(robots)
        self._jacobians = "tool" in spec.capabilities  # what reads them reads the tool
        self._gap_max = (spec.margins.collision_m or 0.0) + GAP_TOLERANCE_M
        self._twice_qdd = 2 * spec.joint_array("qdd_max")
        self.twice_jerk = 2 * spec.joint_array("qddd_max")
        limits = Limits(spec, self._drives.torque_limit)
        motion = checks.motion + (checks.takeover if mode is ControlMode.TORQUE else ())
        self._motion = CheckTable(each, limits, motion)
        self._plan = CheckTable(poses, limits, checks.tool, checks.poses)
        self._estimate = CheckTable(robots, limits, checks.estimate)
        self._poses = CheckTable(rows, limits, checks.poses)
        self._centre = np.array(spec.workspace.centre) if spec.workspace else np.zeros(3)

    # A setpoint that is not finite is refused by its own check: numpy's warnings would add nothing.
    @np.errstate(invalid="ignore", over="ignore")
    def step(self, state: State, sent: Setpoint, setpoint: Setpoint, stop: Stop) -> Verdict:
        """Check one setpoint for each robot.

        Args:
            state: the estimate. sent: the last setpoint sent, which the drives follow now.
            setpoint: to be sent next. stop: that would begin there.
        """
        points, robots = plan_points(setpoint, stop, self.twice_jerk), len(setpoint.q)
        tau = self._drives.torque(state, points.q, points.qd, points.qdd)
        if setpoint.tau is not None and setpoint.drive is not None:
            sent_as_torque = (setpoint.drive.mode == ControlMode.TORQUE)[:, None]
            np.copyto(tau[:robots], setpoint.tau, where=sent_as_torque)
        needed = tau
        if not all_true(state.current_share == 1.0):  # a drive with limited current gives less than its range
            needed = np.concatenate((tau[:robots] / state.current_share, tau[robots:]))
        motion = self._motion.values(Motion(points.q, points.qd, points.qdd, points.qd_peak, tau, needed))
        poses = self._drives.expected_poses(state, points.poses)
        sent_poses, qd_of_tool = points.poses, points.qd_of_tool
        if self._drives.expectations > 1:
            sent_poses, qd_of_tool = (
                np.tile(each, (self._drives.expectations, 1)) for each in (sent_poses, qd_of_tool)
            )
        kinematics = self._kinematics(self._fleet_of_plan, poses)
        tool = ToolMotion(qd_of_tool, self._tool_rows, kinematics)
        plan = self._plan.values(tool, Pose(sent_poses, kinematics, self._centre))
        estimated = Estimate(state, sent, self._twice_qdd, self._fleet_of_estimate)
        estimate = self._estimate.values(estimated)
        reason = _or_zeros(self._estimate.reasons(estimate), robots)
        for found in (self._motion.reasons(motion), self._plan.reasons(plan)):
            if found is not None:
                reason |= np.bitwise_or.reduce(found.reshape(-1, robots))
        values, poses = (motion, plan, estimate), poses.reshape(-1, robots, poses.shape[1])
        ahead_tau = tau[robots : 2 * robots]
        return Verdict(reason=reason, tau=tau[:robots], tau_ahead=ahead_tau, poses=poses, values=values)

    def check_poses(self, q: Floats) -> Ints:
        """Return (R,) bit sets of `Reason` against poses (R, n) rad; R is the width of the fleet."""
        pose = Pose(q, self._kinematics(self._fleet, q), self._centre)
        return _or_zeros(self._poses.reasons(self._poses.values(pose)), len(q))

    def _kinematics(self, fleet: Fleet, q: Floats) -> Kinematics:
        return fleet.kinematics(q, jacobians=self._jacobians)

    def failed(self, verdict: Verdict, robot: int, reason: Reason) -> dict[str, Bools]:
        """Return the checks by which a verdict gave a reason to a robot: by name, (n,) joints that it is about.

        No joint is meant by a check of the robot as a whole.
        """
        *by_point, estimate = verdict.values
        found = self._estimate.failed(estimate[robot], reason)
        for table, values in zip((self._motion, self._plan), by_point, strict=True):
            for of_point in values[robot :: len(estimate)]:
                for name, joints in table.failed(of_point, reason).items():
                    found[name] = joints | found[name] if name in found else joints
        return found

    def names(self, reason: Reason) -> set[str]:
        """Return the names of the checks that give a reason; none where all of them are about joints."""
        checks = (*self._motion.checks, *self._plan.checks, *self._estimate.checks)
        found = [check for check in checks if check.reason is reason]
        return set() if all(check.per_joint for check in found) else {check.name for check in found}

    def colliding_shapes(self, verdict: Verdict, robot: int) -> tuple[str, ...]:
        """Return the names of two shapes of a robot that are too near to each other in a pose of a verdict, or none.

        A pose that is not finite is refused as a collision, too, and has no such shapes.
        """
        gap, *names = self._fleet.nearest_shapes(verdict.poses[:, robot])
        return tuple(names) if gap < self._gap_max else ()


def _or_zeros(reasons: Ints | None, rows: int) -> Ints:
    return np.zeros(rows, dtype=np.int64) if reasons is None else reasons
