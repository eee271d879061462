"""A safety check as one named row, and the records that rows read."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from deploy.reasons import Reason
from deploy.state import STOP_MOMENTS, Setpoint, State
from robots.arrays import Bools, Floats, Ints
from robots.capabilities import Capability, required
from robots.models.fleet import Fleet
from robots.models.kinematics import Kinematics
from robots.spec import RobotSpec

SOON_S = 0.02
"""s until power that is cut is off: the age of samples, the filter's lag and a control period."""
AHEAD_S = 0.006
"""s, at the speeds of joints, within which links of a walker must not come too near to each other. With 8 ms, legs of 3
of 32 H1 do when they pass each other in a minute of walking."""
UNBOUNDED = float(np.finfo(np.float64).max)
"""The largest finite number: as a bound it refuses only what is not finite."""


class Estimate(NamedTuple):
    """Estimate and last setpoint of B robots.

    Attributes:
        twice_qdd: (n,) rad/s², twice the largest acceleration.
        fleet: nominal model, B robots wide, with collisions.
    """

    state: State
    sent: Setpoint
    twice_qdd: Floats
    fleet: Fleet

    @property
    def q_soon(self) -> Floats:
        """(B, n) rad, joints in `SOON_S` at their speeds, or where they brake to at `qdd_max`, if that is nearer."""
        qd = self.state.qd
        soon: Floats = self.state.q + np.minimum(SOON_S, np.abs(qd) / self.twice_qdd) * qd
        return soon

    @property
    def kinematics_ahead(self) -> Kinematics:
        """Kinematics in `AHEAD_S` at the speeds of joints, without Jacobians."""
        return self.fleet.kinematics(self.state.q + AHEAD_S * self.state.qd, jacobians=False)


class Motion(NamedTuple):
    """PB points of trajectories, P = STOP_MOMENTS + 2: B setpoints, the first steps of their stops, where these brake.

    Attributes:
        q: (PB, n) rad. qd: (PB, n) rad/s. qdd: (PB, n) rad/s².
        qd_peak: (PB, n) rad/s, the speed when a stop has brought the acceleration to zero.
        tau: (PB, n) N·m. needed: the same, of setpoints divided by the share of current that each drive has left.
    """

    q: Floats
    qd: Floats
    qdd: Floats
    qd_peak: Floats
    tau: Floats
    needed: Floats

    @property
    def tau_change(self) -> Floats:
        """(PB, n) N·m from the setpoint to the first step of its stop; 0 elsewhere."""
        robots = len(self.tau) // (STOP_MOMENTS + 2)
        change, ahead = np.zeros_like(self.tau), slice(robots, 2 * robots)
        np.subtract(self.tau[ahead], self.tau[:robots], out=change[ahead])
        return change


class ToolMotion(NamedTuple):
    """PB points of trajectories, P = STOP_MOMENTS + 2: B setpoints, those at their peak speed, and where stops brake.

    K times as many for drives with K expectations of where joints are.

    Attributes:
        qd: (PKB, n) rad/s. rows: (PKB,) rows of the poses in `kinematics`.
    """

    qd: Floats
    rows: Ints
    kinematics: Kinematics

    @property
    def speed_squared(self) -> Floats:
        """(PKB, 1) m²/s², of the tool."""
        velocity = self.kinematics.tool_velocity(self.qd, self.rows)
        squared: Floats = np.vecdot(velocity, velocity)
        return squared[:, None]


class Pose(NamedTuple):
    """Poses of R robots.

    Attributes:
        q: (R, n) rad, where joints are sent.
        kinematics: where they are expected, which differs for soft drives.
        workspace_centre: (3,) m; 0 without workspace.
    """

    q: Floats
    kinematics: Kinematics
    workspace_centre: Floats

    @property
    def tool_radius_squared(self) -> Floats:
        """(R, 1) m², squared distance of the tool from the workspace's centre."""
        arm = self.kinematics.tool_position - self.workspace_centre
        squared: Floats = np.vecdot(arm, arm)
        return squared[:, None]


class Limits(NamedTuple):
    """Data from which bounds are computed.

    Attributes:
        robot: its limits, and its margins in the mode of the policy.
        torque: (n,) N·m that a setpoint may need; infinite where drives saturate instead.
    """

    robot: RobotSpec
    torque: Floats

    @property
    def tool_speed(self) -> float:
        """m/s that the tool may have at a setpoint and while it stops."""
        margins = self.robot.margins
        return (margins.tool_speed or margins.speed) * required(self.robot.workspace).tool_speed_max


Record = TypeVar("Record")
Bound = float | Floats | Callable[[Limits], float | Floats]


@dataclass(frozen=True, slots=True, kw_only=True)
class Check(Generic[Record]):
    """One safety check.

    Attributes:
        name: unique in its table.
        value: reader of (R, n) numbers where `per_joint`, else of (R, 1).
        low, high: bounds of the value: a number, (n,) numbers, or a function of the limits.
        reason: given where a value is outside its bounds.
        reason_not_finite: given where a value is not finite.
        per_joint: whether each joint has a value of its own.
        needs: capabilities that the robot must have.
    """

    name: str
    value: Callable[[Record], Floats | Bools]
    low: Bound = -UNBOUNDED
    high: Bound = UNBOUNDED
    reason: Reason
    reason_not_finite: Reason = Reason.NOT_FINITE
    per_joint: bool = False
    needs: frozenset[Capability] = frozenset()
