"""Contents of `robot.toml`, checked as a whole."""

from collections import Counter
from typing import Annotated, Self

from pydantic import Field, model_validator

from robots.contacts import MayTouch
from robots.margins import Margins
from robots.motors.control_mode import ControlMode
from robots.sensors import Kind, Sensor, Sensors, check_sensors
from robots.strict import Name, RobotName, Strict
from robots.tables import Base, Capsule, Joint, Motor, Rates, Workspace

STATE_SENSORS: tuple[Kind, ...] = ("encoder", "velocity")
"""Sensors from which joint state is estimated."""
IMU_SENSORS: tuple[Kind, ...] = ("gyro", "accelerometer")
"""Sensors from which a floating base is estimated, with its feet."""
JOINTS_MAX = 128
"""Joints of a robot and of its model: the memory of a nominal model grows with their cube, here to 0.14 GB."""
BODIES_MAX = 1000
"""Bodies of a model: names in robot.toml are looked for among them."""
SHAPES_MAX, NEIGHBOURS_MAX, CONTACTS_MAX = 500, 5000, 500
"""Shapes of a robot, and its pairs of `neighbours` and of `may_touch`."""
MODEL = "model.xml"
"""Default file name of the model."""
ModelName = Annotated[
    str, Field(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9_.-]*(/[A-Za-z0-9_-][A-Za-z0-9_.-]*)*\.(xml|urdf)$")
]


def _is_default(value: object) -> bool:
    """Return True if a key has its default: it is left out of the digest, which a new key must not change."""
    return value in (None, (), MODEL)


class RobotFile(Strict):
    """Contents of robot.toml.

    Tool, workspace, base and the margins that belong to them are optional, each on its own: see `capabilities` of
    `RobotSpec`.

    Attributes:
        name: of the robot, which contracts carry.
        model: file of the folder, MJCF (.xml) or URDF (.urdf).
        tool: a site or a body of the model.
        workspace: bounds on the tool; of a robot with a base, in the frame of its root body.
        base: a floating base; without one, the robot is fixed to the world.
        locked: joints of the model that stay at 0 and have no drive.
        capsules: shapes of bodies for collision checks; empty for the shapes of the model.
        neighbours: pairs of bodies that are always near each other, and are not checked for collision.
        may_touch: pairs of bodies whose contact is no collision.
        rates, margins, sensors, motors, joints: see their classes; motors by name, joints in the order of every vector.
    """

    name: RobotName
    model: Annotated[ModelName, Field(exclude_if=_is_default)] = MODEL
    tool: Name | None = None
    locked: Annotated[tuple[Name, ...], Field(max_length=JOINTS_MAX, exclude_if=_is_default)] = ()
    capsules: Annotated[tuple[Capsule, ...], Field(max_length=SHAPES_MAX, exclude_if=_is_default)] = ()
    neighbours: Annotated[
        tuple[tuple[Name, Name], ...], Field(max_length=NEIGHBOURS_MAX, exclude_if=_is_default)
    ] = ()
    may_touch: Annotated[tuple[MayTouch, ...], Field(max_length=CONTACTS_MAX, exclude_if=_is_default)] = ()
    rates: Rates
    margins: Margins
    workspace: Workspace | None = None
    base: Base | None = None
    sensors: Sensors
    motors: Annotated[dict[Name, Motor], Field(max_length=JOINTS_MAX)]
    joints: Annotated[tuple[Joint, ...], Field(min_length=1, max_length=JOINTS_MAX)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self._check_capabilities()
        self._check_sensors()
        self._check_motors()
        self._check_locked()
        self._check_contacts()
        self._check_drives()
        self._check_margins()
        self._check_heat()
        return self

    def _check_capabilities(self) -> None:
        margins = self.margins
        of_tool = {"workspace": self.workspace, "margins.singularity": margins.singularity}
        for name, found in of_tool.items():
            if found is not None and self.tool is None:
                raise ValueError(f"{name}: found {found}, expected none of a robot without tool")
        for name in ("workspace_m", "tool_speed"):
            found = getattr(margins, name)
            if self.workspace is None and found is not None:
                raise ValueError(f"margins.{name}: found {found}, expected none of a robot without workspace")
        if self.workspace is not None and margins.workspace_m is None:
            raise ValueError("margins.workspace_m: missing, expected one of a robot with a workspace")
        for name in ("workspace_m", "tool_speed", "collision_m"):
            self._check_margin_of_modes(name)

    def _check_margin_of_modes(self, name: str) -> None:
        """Refuse a margin of one mode that the robot does not have in the others."""
        for mode in ("velocity_mode", "torque_mode"):
            found = getattr(getattr(self.margins, mode), name, None)
            if found is not None and getattr(self.margins, name) is None:
                raise ValueError(
                    f"margins.{mode}.{name}: found {found}, expected none without margins.{name}"
                )

    def _check_sensors(self) -> None:
        check_sensors(self.sensors, self.rates.control_hz)
        for kind in IMU_SENSORS if self.base else ():
            if kind not in self.sensors:
                raise ValueError(f"sensors: no {kind}, which a base needs; found {', '.join(self.sensors)}")
        for kind in STATE_SENSORS:
            if kind in self.sensors:
                self._check_delay(kind, self.sensors[kind])

    def _check_delay(self, kind: Kind, sensor: Sensor) -> None:
        """Refuse a sensor whose packets are stale when they arrive: they would stop the robot for ever."""
        every_s = 1.0 / sensor.rate_hz
        if not sensor.delay_s + every_s < self.margins.stale_s:
            raise ValueError(
                f"sensors.{kind}.delay_s: found {sensor.delay_s}, and a packet every {every_s:.3g} s: together expected"
                f" below margins.stale_s {self.margins.stale_s}"
            )

    def _check_motors(self) -> None:
        for joint in self.joints:
            if joint.motor not in self.motors:
                raise ValueError(
                    f"joint {joint.name} names motor {joint.motor!r}; known: {', '.join(self.motors)}"
                )
        if ControlMode.TORQUE in self.control_modes:
            self._check_torque_mode()

    def _check_torque_mode(self) -> None:
        """Refuse a robot whose drives follow torques without limits for that, or without a fixed base."""
        if self.base is not None:
            raise ValueError(
                "motors: modes: found 'torque', expected none of a robot with a base: its motion cannot be predicted"
            )
        for joint in self.joints:
            if joint.torque_mode is None:
                raise ValueError(
                    f"joints.{joint.name}.torque_mode: missing, and its motor has the mode 'torque'"
                )
        if self.margins.torque_mode is None:
            raise ValueError("margins.torque_mode: missing, and all motors have the mode 'torque'")

    def _check_locked(self) -> None:
        times = Counter((*self.locked, *self.joint_names))
        for name in self.locked:
            if times[name] > 1:
                raise ValueError(
                    f"locked: found {name!r}, expected each once and none that is listed in joints"
                )

    def _check_contacts(self) -> None:
        for pair, times in Counter(tuple(sorted(pair.bodies)) for pair in self.may_touch).items():
            if times > 1:
                raise ValueError(f"may_touch: found {list(pair)} {times} times, expected each pair once")
        points = Counter((*(self.base.feet if self.base else ()), *([self.tool] if self.tool else [])))
        if twice := [name for name, times in points.items() if times > 1]:
            raise ValueError(
                f"base.feet: found {twice[0]!r} twice, expected each once and none that is the tool"
            )

    def _check_drives(self) -> None:
        used = {joint.motor: self.motors[joint.motor].drive for joint in self.joints}
        without = [name for name, drive in used.items() if drive is None]
        if without and len(without) < len(used):
            raise ValueError(
                f"motors.{without[0]}.drive: missing, but other motors have one: expected one for all, or none and"
                " the drives of the model"
            )

    def _check_margins(self) -> None:
        for joint in self.joints:
            if joint.q_max - joint.q_min <= 2 * self.margins.q_target_rad:
                raise ValueError(
                    f"margins.q_target_rad {self.margins.q_target_rad} leaves nothing of the range of {joint.name}"
                )

    def _check_heat(self) -> None:
        for name, motor in self.motors.items():
            if not motor.winding_soft_c < motor.winding_max_c - self.margins.winding_k:
                raise ValueError(
                    f"motors.{name}: winding_soft_c {motor.winding_soft_c} is not below winding_max_c"
                    f" {motor.winding_max_c} less margins.winding_k {self.margins.winding_k}"
                )

    @property
    def control_modes(self) -> tuple[ControlMode, ...]:
        """Control modes that the drives of all joints have."""
        motors = [self.motors[joint.motor] for joint in self.joints]
        return tuple(mode for mode in ControlMode if all(mode.name.lower() in each.modes for each in motors))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in the order of every joint vector."""
        return tuple(joint.name for joint in self.joints)
