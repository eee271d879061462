"""Table `[margins]` of robot.toml: distances that the parts of the stack keep from limits."""

import math
from typing import Annotated, Self

from pydantic import Field, PositiveInt, model_validator

from robots.motors.control_mode import ControlMode
from robots.strict import NotNegative, Positive, Strict, is_none

Fraction = Annotated[float, Field(ge=1e-3, le=1)]


class ModeMargins(Strict):
    """Margins that differ in one control mode: see `Margins`; None: the same as in the others."""

    q_soft_rad: Annotated[Positive | None, Field(exclude_if=is_none)] = None
    speed: Fraction | None = None
    tau: Fraction | None = None
    tool_speed: Annotated[Fraction | None, Field(exclude_if=is_none)] = None
    collision_m: Positive | None = None
    workspace_m: Positive | None = None


class Margins(Strict):
    """Distances that the parts of the stack keep from limits, and limits of the stack itself.

    Attributes:
        q_target_rad: targets are clamped this far inside the working range.
        q_soft_rad: setpoints are refused, and the judge calls it soft, this far inside. With a floating base, a joint
            that is, or will be in 20 ms, nearer to its end than half of this counts as a fall.
        speed: setpoint speed, as a fraction of qd_max: the rest is for the drive's own ringing, and for the play of its
            gear, through which a light link falls. With a floating base, a joint faster than halfway between this and
            qd_max counts as a fall.
        tau: setpoint torque by the nominal model, as a fraction of the torque range; the limit of soft drives.
        tool_speed: the tool's speed at a setpoint and in its stop, as a fraction of tool_speed_max, of robots with a
            workspace; None: as `speed`.
        collision_m: clearance between capsules; without it, self-collision is not checked.
        workspace_m: how far inside the workspace setpoints stay; required with a workspace, refused without.
        singularity: least manipulability (`Kinematics.manipulability`), m³ for a six-joint arm, of robots with a tool;
            without it, singularities are not checked.
        tracking_rad: tracking error, setpoint minus estimate, that stops the robot.
        stale_s: age of the newest sample at which the robot stops and holds.
        lost_s: age of the newest sample at which it stops and cuts power.
        stops_max, stops_s: as many stops within as many s, without a goal reached in between, cut power.
        oscillation_hz: frequency at which a joint may swing for seconds, with a tenth of its speed limit between peaks;
            without it, oscillation is not looked for. Its speed is looked at 50 times a second.
        winding_k, winding_share: K, and share of its rise over the housing, by which a winding may be hotter than
            estimated: the robot latches when it may have come to winding_max_c.
        fold_min: share of its current that a motor keeps at winding_max_c. From winding_soft_c on it falls to that.
        pace_min: share of speed and acceleration that setpoints keep at winding_max_c: low enough for the motion to
            need no more current than is left, gravity included.
        velocity_mode: what differs in velocity mode, where a policy may shake.
        torque_mode: what differs in torque mode, where motion is predicted and estimated with larger errors; needed if
            the drives have that mode.
    """

    q_target_rad: Positive
    q_soft_rad: Positive
    speed: Fraction
    tau: Fraction
    tool_speed: Annotated[Fraction | None, Field(exclude_if=is_none)] = None
    collision_m: Positive | None = None
    workspace_m: Positive | None = None
    singularity: Positive | None = None
    tracking_rad: Annotated[Positive, Field(le=math.pi)]
    stale_s: Annotated[Positive, Field(le=1.0)]
    lost_s: Annotated[Positive, Field(le=1.0)]
    stops_max: Annotated[PositiveInt, Field(le=1000)]
    stops_s: Annotated[Positive, Field(le=86_400.0)]
    oscillation_hz: Annotated[Positive | None, Field(le=20.0, exclude_if=is_none)] = None
    winding_k: Positive
    winding_share: NotNegative
    fold_min: Fraction
    pace_min: Fraction
    velocity_mode: Annotated[ModeMargins | None, Field(exclude_if=is_none)] = None
    torque_mode: Annotated[ModeMargins | None, Field(exclude_if=is_none)] = None

    def of(self, mode: ControlMode) -> Self:
        """Return the margins in a control mode."""
        own = {ControlMode.VELOCITY: self.velocity_mode, ControlMode.TORQUE: self.torque_mode}.get(mode)
        return self.model_copy(update=own.model_dump(exclude_none=True)) if own else self

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        margins = {"q_soft_rad": self, "velocity_mode.q_soft_rad": self.velocity_mode}
        for name, own in margins.items():  # targets of torque mode are no angles
            soft = own.q_soft_rad if own else None
            if soft is not None and not soft < self.q_target_rad:
                raise ValueError(f"{name} {soft} is not below q_target_rad {self.q_target_rad}")
        if not self.stale_s < self.lost_s:
            raise ValueError(f"stale_s {self.stale_s} is not below lost_s {self.lost_s}")
        return self
