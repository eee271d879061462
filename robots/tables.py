"""The tables of robot.toml: joints, motors, rates, margins, and where a robot stands."""

from typing import Annotated, Self

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from robots.drive import Drive
from robots.strict import Source, Strict

Celsius = Annotated[float, Field(ge=-50, le=300)]
Fraction = Annotated[float, Field(gt=0, le=1)]


class Joint(Strict):
    """Working limits of one joint, as an integrator sets them: inside the mechanical ones of model.xml.

    Attributes:
        q_min, q_max, q_home: rad.
        qd_max: rad/s, what the drive may do. qdd_max: rad/s², qddd_max: rad/s³, what it is asked to do.
        acceleration_density: rad²/s³, how restless the estimator takes its deviation from the setpoint to be; on the
            soft drives of a robot that walks, the joint itself.
        play: rad, how far the link can move while the encoder stands still.
        motor: a name in `motors`.
        source: where the numbers come from.
    """

    name: str
    q_min: float
    q_max: float
    q_home: float
    qd_max: PositiveFloat
    qdd_max: PositiveFloat
    qddd_max: PositiveFloat
    acceleration_density: PositiveFloat
    play: Annotated[float, Field(ge=0)]
    motor: str
    source: Source

    @model_validator(mode="after")
    def _home_inside(self) -> Self:
        if not self.q_min < self.q_home < self.q_max:
            raise ValueError(
                f"q_home of {self.name} is {self.q_home} rad, outside [{self.q_min}, {self.q_max}]"
            )
        return self


class Motor(Strict):
    """The housing node and the heat limits of a motor.

    Attributes:
        housing_resistance_k_per_w: K/W, housing to ambient.
        housing_capacity_j_per_k: J/K.
        iron_w_s2: W/(rad/s)² of the motor's shaft, eddy currents: what turning alone makes of heat.
        winding_soft_c, winding_max_c: °C, where warning begins and where damage begins.
        housing_soft_c, housing_max_c: °C, where the operator is warned, and where the robot stops for good.
        drive: its winding and what drives it, where the model has no `dcmotor` that says so.
        source: where the numbers come from.
    """

    housing_resistance_k_per_w: PositiveFloat
    housing_capacity_j_per_k: PositiveFloat
    iron_w_s2: Annotated[float, Field(ge=0)]
    winding_soft_c: Celsius
    winding_max_c: Celsius
    housing_soft_c: Celsius
    housing_max_c: Celsius
    drive: Drive | None = None
    source: Source

    @model_validator(mode="after")
    def _housing_ordered(self) -> Self:
        if not self.housing_soft_c < self.housing_max_c:
            raise ValueError(
                f"housing_soft_c {self.housing_soft_c} is not below housing_max_c {self.housing_max_c}"
            )
        return self


class Rates(Strict):
    """Hz. Physics is a multiple of control."""

    control_hz: PositiveInt
    physics_hz: PositiveInt

    @model_validator(mode="after")
    def _divides(self) -> Self:
        if self.physics_hz % self.control_hz:
            raise ValueError(
                f"physics_hz {self.physics_hz} is not a multiple of control_hz {self.control_hz}"
            )
        return self


class Margins(Strict):
    """How far from each limit the parts of the stack stay.

    Attributes:
        q_target_rad: targets are clamped this far inside the working range.
        q_soft_rad: setpoints are refused, and the judge calls it soft, this far inside.
        speed: setpoint speed, as a fraction of qd_max and of tool_speed_max: the rest is for the drive's own ringing.
        tau: setpoint torque by the nominal model, as a fraction of the torque range.
        collision_m: clearance kept between capsules; without it, self-collision is not checked.
        workspace_m: how far inside the workspace setpoints stay; of robots with a workspace, and of all of those.
        singularity: least manipulability (`Kinematics.manipulability`), m³ for a six-joint arm, of robots with a tool;
            without it, singularities are not checked.
        tracking_rad: setpoint minus estimate that stops the robot.
        stale_s: age of the newest sample that makes the robot slow down and hold.
        lost_s: age of the newest sample that makes it stop and cut power.
        winding_k, winding_share: K, and share of its rise over the housing, by which a winding may be hotter than it is
            believed to be: the robot stops for good where it may have come to winding_max_c.
        fold_min: share of its current that a motor keeps there. From winding_soft_c on it falls to this share.
        pace_min: share of speed and acceleration that the robot is still asked for there: low enough for the motion
            to need no more current than is left, gravity included.
    """

    q_target_rad: PositiveFloat
    q_soft_rad: PositiveFloat
    speed: Fraction
    tau: Fraction
    collision_m: PositiveFloat | None = None
    workspace_m: PositiveFloat | None = None
    singularity: PositiveFloat | None = None
    tracking_rad: PositiveFloat
    stale_s: PositiveFloat
    lost_s: PositiveFloat
    winding_k: PositiveFloat
    winding_share: Annotated[float, Field(ge=0)]
    fold_min: Fraction
    pace_min: Fraction

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.q_soft_rad < self.q_target_rad:
            raise ValueError(f"q_soft_rad {self.q_soft_rad} is not below q_target_rad {self.q_target_rad}")
        if not self.stale_s < self.lost_s:
            raise ValueError(f"stale_s {self.stale_s} is not below lost_s {self.lost_s}")
        return self


class Workspace(Strict):
    """Where the tool may be, in the world frame.

    Attributes:
        z_min: m, above the table.
        radius_max: m, from `centre`.
        centre: m, (x, y, z).
        tool_speed_max: m/s.
    """

    z_min: float
    radius_max: PositiveFloat
    centre: tuple[float, float, float]
    tool_speed_max: PositiveFloat


class Base(Strict):
    """A base that stands on nothing but its feet. Its frame is the IMU's, with the axes of model.xml's root body.

    Attributes:
        feet: bodies or sites of model.xml that stand on the ground.
        foot_m: m, how much higher than the lowest foot another may be and still be said to stand; only where no
            contact sensor says so.
        may_touch: pairs of bodies that may touch each other, as feet that brush do at every step.
        slip: m/s/√Hz, velocity of a standing foot, with the errors of its kinematics.
        angular_acceleration: rad/s²/√Hz, jerk: m/s³/√Hz, of motion that nobody sees between two samples of the IMU.
        tilt_max_rad: what it may lean; beyond it has fallen.
        command_min, command_max: m/s forwards, m/s to the left, rad/s to the left: what it may be asked for.
        command_s: s for each command.
        source: where the numbers come from.
    """

    feet: Annotated[tuple[str, ...], Field(min_length=1)]
    foot_m: Annotated[float, Field(ge=0)]
    may_touch: tuple[tuple[str, str], ...] = ()
    slip: PositiveFloat
    angular_acceleration: PositiveFloat
    jerk: PositiveFloat
    tilt_max_rad: Annotated[float, Field(gt=0, lt=1.5)]
    command_min: tuple[float, float, float]
    command_max: tuple[float, float, float]
    command_s: PositiveFloat
    source: Source

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for low, high in zip(self.command_min, self.command_max, strict=True):
            if low > high:
                raise ValueError(f"base.command_min: found {low}, above command_max {high}")
        return self
