"""Whether a setpoint may be sent: the last word before the supervisor.

Pure: (state, setpoint) → verdict, by the nominal model in Pinocchio. It never edits a number and knows neither
policy nor smoother. Beside the setpoint it checks the stop that would begin there, its first step and the pose where
it ends. What lies between those two is not looked at: the margins are for that.
"""

import numpy as np

from deploy.state import Bools, Floats, Ints, Reason, Setpoint, State, Verdict
from robots.model_pinocchio import Fleet, torque_max
from robots.spec import RobotSpec

TOLERANCE = 1e-6
"""Relative slack on speed: Ruckig meets its limits exactly, up to rounding."""


class Safety:
    """Every check on every tick for every robot."""

    def __init__(self, spec: RobotSpec, fleet: Fleet) -> None:
        """Read the limits.

        Args:
            spec: the robot.
            fleet: its nominal model, B robots wide.
        """
        self._fleet, margins = fleet, spec.margins
        self._margins = margins
        self._centre = np.array(spec.workspace.centre)
        self._radius_max = spec.workspace.radius_max - margins.workspace_m
        self._z_min = spec.workspace.z_min + margins.workspace_m
        self._tool_speed_max = margins.speed * spec.workspace.tool_speed_max
        self._twice_jerk = 2 * spec.joint_array("qddd_max")
        self._working_min, self._working_max = spec.joint_array("q_min"), spec.joint_array("q_max")
        self._q_min = self._working_min + margins.q_soft_rad
        self._q_max = self._working_max - margins.q_soft_rad
        # Ages are whole ticks but for rounding: half a tick keeps a limit that is one of them in its place.
        self._stale_s, self._lost_s = margins.stale_s + spec.dt / 2, margins.lost_s + spec.dt / 2
        self._qd_max = margins.speed * spec.joint_array("qd_max") * (1 + TOLERANCE)
        self._tau_max = margins.tau * torque_max(spec)
        self._housing_max = spec.motor_array("housing_max_c")

    # A setpoint without a number is refused by its own check; the others need not complain.
    @np.errstate(invalid="ignore")
    def step(
        self, state: State, sent: Setpoint, setpoint: Setpoint, ahead: Setpoint, q_rest: Floats
    ) -> Verdict:
        """Judge one setpoint for each robot.

        Args:
            state: what the estimator believes.
            sent: the last setpoint sent, which the drives follow now.
            setpoint: what would be sent next.
            ahead: the first step of the stop that would begin at `setpoint`.
            q_rest: (B, n) rad, where that stop would end.
        """
        reason = self._state(state, sent)
        tau = self._motion(setpoint, reason)
        tau_ahead = self._motion(ahead, reason)
        self._tool(setpoint, reason)
        self.check_pose(q_rest, reason)
        return Verdict(reason=reason, tau=tau, tau_ahead=tau_ahead)

    def _state(self, state: State, sent: Setpoint) -> Ints:
        """Reasons that lie in what is, not in what is asked."""
        finite = np.isfinite(state.q + state.qd).all(axis=1)
        error = np.abs(sent.q - state.q)
        reason = _if(~finite, Reason.NOT_FINITE)
        outside = ((state.q < self._working_min) | (state.q > self._working_max)).any(axis=1)
        reason |= _if((error > self._margins.tracking_rad).any(axis=1), Reason.TRACKING)
        reason |= _if(outside, Reason.OUTSIDE)
        # Negated, so that a reading that is not a number counts as bad.
        reason |= _if(~(state.temperature <= self._housing_max).all(axis=1), Reason.HEAT)
        reason |= _if(~(state.age <= self._stale_s), Reason.STALE)
        reason |= _if(~(state.age <= self._lost_s), Reason.LOST)
        return reason

    def _motion(self, s: Setpoint, reason: Ints) -> Floats:
        """Add the reasons of one step to `reason`; return its torque (B, n) N·m."""
        finite = np.isfinite(s.q + s.qd + s.qdd).all(axis=1)
        reason |= _if(~finite, Reason.NOT_FINITE)
        tau = self._fleet.torque(s.q, s.qd, s.qdd).copy()
        reason |= _if(((s.q < self._q_min) | (s.q > self._q_max)).any(axis=1), Reason.POSITION)
        reason |= _if((np.abs(s.qd) > self._qd_max).any(axis=1), Reason.VELOCITY)
        reason |= _if((np.abs(tau) > self._tau_max).any(axis=1), Reason.TORQUE)
        return tau

    def _tool(self, s: Setpoint, reason: Ints) -> None:
        """Where the tool would be, and how fast: a stop first lets the acceleration run out, and that speed counts."""
        self._place(s.q, reason)
        qd_peak = s.qd + s.qdd * np.abs(s.qdd) / self._twice_jerk
        for qd in (s.qd, qd_peak):
            speed = (self._fleet.tool_velocity(qd) ** 2).sum(axis=1)
            reason |= _if(speed > self._tool_speed_max**2, Reason.TOOL_SPEED)

    def check_pose(self, q: Floats, reason: Ints) -> None:
        """Add to `reason` (B,) what speaks against resting at `q` (B, n) rad."""
        reason |= _if(((q < self._q_min) | (q > self._q_max)).any(axis=1), Reason.POSITION)
        self._place(q, reason)

    def _place(self, q: Floats, reason: Ints) -> None:
        """Place the fleet at `q` and add what speaks against being there."""
        fleet = self._fleet
        fleet.place(q)
        reason |= _if(fleet.manipulability() < self._margins.singularity, Reason.SINGULARITY)
        reason |= _if(fleet.colliding(), Reason.COLLISION)
        tool = fleet.tool_position
        far = ((tool - self._centre) ** 2).sum(axis=1) > self._radius_max**2
        reason |= _if(far | (tool[:, 2] < self._z_min), Reason.WORKSPACE)


def _if(condition: Bools | np.bool_, reason: Reason) -> Ints:
    return np.asarray(condition * np.int64(reason))
