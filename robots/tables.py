"""Tables of robot.toml: joints, drives, motors, rates, workspace, capsules, floating base."""

import math
from typing import Annotated, Self

import numpy as np
from pydantic import Field, PositiveInt, model_validator

from robots.motors.control_mode import ControlModes
from robots.sensors import FEET_MAX
from robots.strict import Coordinate, Name, NotNegative, Positive, Source, Strict, is_none

Celsius = Annotated[float, Field(ge=-50, le=300)]
Heat = Annotated[float, Field(ge=1, le=300)]
"""Limit of a temperature, °C: the judge divides by it."""
POSITION_ONLY: ControlModes = ("position",)
"""Control modes of a motor that names none."""


class TorqueMode(Strict):
    """Limits of a joint in torque mode, where the drive follows no angle.

    Attributes:
        rate_max: N·m/s, rate2_max: N·m/s²: first and second rate of the torque sent.
        acceleration_density: rad²/s³, process noise of the estimator: of the joint's motion around the one that the
            nominal model predicts. Also of a joint without stiffness in velocity mode, such as a wheel.
    """

    rate_max: Positive
    rate2_max: Positive
    acceleration_density: Positive


LONGEST_S = 100.0
"""s, the longest of range / qd_max, qd_max / qdd_max and qdd_max / qddd_max: the planner fails beyond it."""


class Joint(Strict):
    """Working limits of one joint, as an integrator sets them: inside the mechanical ones of model.xml.

    Attributes:
        q_min, q_max: rad, the working range; both left out for a joint without ends, such as a wheel. q_home: rad.
        qd_max: rad/s, limit of the drive. qdd_max: rad/s², qddd_max: rad/s³, limits of setpoints.
        acceleration_density: rad²/s³, process noise of the estimator: of the joint's deviation from its setpoint, or of
            the joint itself on drives that act as springs.
        play: rad by which the link can move while the encoder stands still.
        motor: a name in `motors`.
        torque_mode: limits in torque mode; needed if the motor's drive can follow torques.
        source: where the numbers come from.
    """

    name: Name
    q_min: Annotated[float, Field(exclude_if=math.isinf)] = -math.inf
    q_max: Annotated[float, Field(exclude_if=math.isinf)] = math.inf
    q_home: float
    qd_max: Positive
    qdd_max: Positive
    qddd_max: Positive
    acceleration_density: Positive
    play: NotNegative
    motor: Name
    torque_mode: Annotated[TorqueMode | None, Field(exclude_if=is_none)] = None
    source: Source

    @model_validator(mode="after")
    def _range_around_home(self) -> Self:
        if math.isinf(self.q_min) != math.isinf(self.q_max):
            raise ValueError(
                f"{self.name}: found one of q_min and q_max, expected both, or none of a joint without ends"
            )
        if not self.q_min < self.q_home < self.q_max:
            raise ValueError(
                f"q_home of {self.name} is {self.q_home} rad, outside [{self.q_min}, {self.q_max}]"
            )
        return self

    @model_validator(mode="after")
    def _reaches_its_limits(self) -> Self:
        times = {
            "qd_max / qdd_max": self.qd_max / self.qdd_max,
            "qdd_max / qddd_max": self.qdd_max / self.qddd_max,
        }
        if not math.isinf(self.q_max):
            times["(q_max - q_min) / qd_max"] = (self.q_max - self.q_min) / self.qd_max
        for name, seconds in times.items():
            if not seconds <= LONGEST_S:
                raise ValueError(
                    f"{name} of {self.name}: found {seconds:.3g} s, expected at most {LONGEST_S:g} s"
                )
        return self


class Drive(Strict):
    """Motor with a gear that follows position, speed and torque; gains and torque are at the joint.

    Attributes:
        gear: turns of the motor for one turn of the joint.
        torque_constant: N·m/A of the motor, without its gear.
        resistance_ohm: of the winding at `reference_c`, °C. copper_per_k: 1/K, its growth with temperature.
        winding_resistance_k_per_w: K/W, winding to housing.
        winding_capacity_j_per_k: J/K, the winding's time constant divided by its thermal resistance.
        supply_v: V, the highest voltage of the motor.
        kp, kd: N·m/rad and N·m·s/rad.
        torque_max: N·m, for joints without a torque range in the model.
        armature: kg·m² of the rotor, times gear², for joints without one in the model. Without it a joint with play is
            so light that a stiff drive oscillates.
    """

    gear: Positive
    torque_constant: Positive
    resistance_ohm: Positive
    reference_c: Celsius
    copper_per_k: NotNegative
    winding_resistance_k_per_w: Positive
    winding_capacity_j_per_k: Positive
    supply_v: Positive
    kp: Positive
    kd: NotNegative
    torque_max: Positive | None = None
    armature: Positive | None = None


class Motor(Strict):
    """The housing node and the heat limits of a motor.

    Attributes:
        housing_resistance_k_per_w: K/W, housing to ambient.
        housing_capacity_j_per_k: J/K.
        iron_w_s2: W/(rad/s)² of the motor's shaft: heat of eddy currents.
        winding_soft_c, winding_max_c: °C, thresholds of warning and of damage.
        housing_soft_c, housing_max_c: °C, thresholds of a warning and of a latched stop.
        modes: control modes that its drive has.
        drive: its winding and its amplifier, where the model has no `dcmotor`.
        source: where the numbers come from.
    """

    housing_resistance_k_per_w: Positive
    housing_capacity_j_per_k: Positive
    iron_w_s2: NotNegative
    winding_soft_c: Heat
    winding_max_c: Heat
    housing_soft_c: Heat
    housing_max_c: Heat
    modes: Annotated[ControlModes, Field(exclude_if=lambda modes: modes == POSITION_ONLY)] = POSITION_ONLY
    drive: Drive | None = None
    source: Source

    @model_validator(mode="after")
    def _housing_ordered(self) -> Self:
        if not self.housing_soft_c < self.housing_max_c:
            raise ValueError(
                f"housing_soft_c {self.housing_soft_c} is not below housing_max_c {self.housing_max_c}"
            )
        return self


SUBSTEPS_MAX = 100
"""Steps of physics in a control period, which one call of MuJoCo takes: it is deaf to Ctrl-C meanwhile."""


class Rates(Strict):
    """Rates of control and physics, Hz; physics is a multiple of control, up to `SUBSTEPS_MAX`."""

    control_hz: Annotated[PositiveInt, Field(le=10_000)]
    physics_hz: Annotated[PositiveInt, Field(le=100_000)]

    @model_validator(mode="after")
    def _divides(self) -> Self:
        if self.physics_hz % self.control_hz:
            raise ValueError(
                f"physics_hz {self.physics_hz} is not a multiple of control_hz {self.control_hz}"
            )
        if self.physics_hz > SUBSTEPS_MAX * self.control_hz:
            raise ValueError(
                f"physics_hz: found {self.physics_hz}, expected at most {SUBSTEPS_MAX} times control_hz"
                f" {self.control_hz}"
            )
        return self


class Workspace(Strict):
    """Bounds of the tool: in the world; of a robot with a floating base, in the frame of its root body.

    Attributes:
        z_min: m, above the table.
        radius_max: m, from `centre`.
        centre: m, (x, y, z).
        tool_speed_max: m/s.
    """

    z_min: Coordinate
    radius_max: Positive
    centre: tuple[Coordinate, Coordinate, Coordinate]
    tool_speed_max: Positive


class Capsule(Strict):
    """Points nearer than `radius` to the line from `start` to `end`, m, frame of `body`: a link in collision checks."""

    body: Name
    start: tuple[Coordinate, Coordinate, Coordinate]
    end: tuple[Coordinate, Coordinate, Coordinate]
    radius: Positive

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        if np.allclose(self.start, self.end, rtol=0.0, atol=1e-6):
            raise ValueError(f"start and end are both {list(self.start)}, expected a line between them")
        return self


class Base(Strict):
    """Floating base that stands on its feet. Its frame is the IMU's, with the axes of model.xml's root body.

    Attributes:
        feet: bodies or sites of model.xml that stand on the ground.
        foot_m: m by which another foot may be higher than the lowest and count as standing; only without contact
            sensors.
        slip: m/s/√Hz, velocity of a standing foot, with the errors of its kinematics.
        angular_acceleration: rad/s²/√Hz, jerk: m/s³/√Hz, of motion between two samples of the IMU.
        tilt_max_rad: a tilt above it counts as a fall.
        height_min_m: m; an IMU lower than this above the lowest foot counts as a fall; the judge's is above the floor.
        descent_max: m/s; an IMU that comes down faster counts as a fall for the runtime. More than any motion of its
            policies has, squatting and jumping too, with the error of the estimate (0.15 m/s).
        command_min, command_max: m/s forwards, m/s to the left, rad/s to the left: range of commands.
        command_s: s for each command.
        source: where the numbers come from.
    """

    feet: Annotated[tuple[Name, ...], Field(min_length=1, max_length=FEET_MAX)]
    foot_m: NotNegative
    slip: Positive
    angular_acceleration: Positive
    jerk: Positive
    tilt_max_rad: Annotated[float, Field(gt=0, lt=1.5)]
    height_min_m: Positive
    descent_max: Positive
    command_min: tuple[Coordinate, Coordinate, Coordinate]
    command_max: tuple[Coordinate, Coordinate, Coordinate]
    command_s: Positive
    source: Source

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for low, high in zip(self.command_min, self.command_max, strict=True):
            if low > high:
                raise ValueError(f"base.command_min: found {low}, above command_max {high}")
        return self
