"""What a robot is: `robot.toml` beside `model.xml`, read strictly.

Geometry, inertia, mechanical joint range and torque range live in model.xml, and motor constants if it has drives of
its own; the rest is here.
"""

import hashlib
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from robots.capabilities import Capability
from robots.capsule import Capsule
from robots.drive import Drive
from robots.errors import RobotError
from robots.models.files import named_files, read_xml
from robots.sensors import Kind, Sensor, Sensors, channels, check_sensors
from robots.strict import Strict, read_toml
from robots.tables import Base, Joint, Margins, Motor, Rates, Workspace

ROBOTS = Path(__file__).parent

FUSED: tuple[Kind, ...] = ("encoder", "velocity")
"""What a robot's state is estimated from."""
INERTIAL: tuple[Kind, ...] = ("gyro", "accelerometer")
"""What a base is estimated from, beside its feet."""
MODEL = "model.xml"
"""What a model is called unless robot.toml says otherwise."""
ModelName = Annotated[
    str, Field(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9_.-]*(/[A-Za-z0-9_-][A-Za-z0-9_.-]*)*\.(xml|urdf)$")
]


def _unsaid(value: object) -> bool:
    """What a file does not say is not part of its digest, which is then that of before there was such a key."""
    return value in (None, (), MODEL)


class RobotSpec(Strict):
    """One robot folder: the strict reading of robot.toml, plus the folder itself.

    Tool, workspace, base and the margins that belong to them are optional, each on its own: see `capabilities`.

    Attributes:
        model: file of the folder, MJCF (.xml) or URDF (.urdf).
        tool: a site or a body of the model.
        workspace: bounds on the tool; of a robot with a base, in the frame of its root body.
        base: a floating base; without one, the robot is fixed to the world.
        locked: joints of the model that stay at 0 and that nobody drives.
        capsules: what bodies are taken for where they might meet; empty for the shapes that the model has.
        neighbours: pairs of bodies that are always near, so that nobody asks whether they meet.
    """

    folder: Path
    name: str
    model: Annotated[ModelName, Field(exclude_if=_unsaid)] = MODEL
    tool: str | None = None
    locked: Annotated[tuple[str, ...], Field(exclude_if=_unsaid)] = ()
    capsules: Annotated[tuple[Capsule, ...], Field(exclude_if=_unsaid)] = ()
    neighbours: Annotated[tuple[tuple[str, str], ...], Field(exclude_if=_unsaid)] = ()
    rates: Rates
    margins: Margins
    workspace: Workspace | None = None
    base: Base | None = None
    sensors: Sensors
    motors: dict[str, Motor]
    joints: Annotated[tuple[Joint, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _capabilities_complete(self) -> Self:
        margins = self.margins
        of_tool = {"workspace": self.workspace, "margins.singularity": margins.singularity}
        for name, found in of_tool.items():
            if found is not None and self.tool is None:
                raise ValueError(f"{name}: found {found}, expected none of a robot without tool")
        if self.workspace is None and margins.workspace_m is not None:
            raise ValueError(
                f"margins.workspace_m: found {margins.workspace_m}, expected none of a robot without workspace"
            )
        if self.workspace is not None and margins.workspace_m is None:
            raise ValueError("margins.workspace_m: missing, expected one of a robot with a workspace")
        return self

    @model_validator(mode="after")
    def _sensors_fit(self) -> Self:
        check_sensors(self.sensors, self.rates.control_hz)
        for kind in INERTIAL if self.base else ():
            if kind not in self.sensors:
                raise ValueError(f"sensors: no {kind}, which a base needs; found {', '.join(self.sensors)}")
        for kind in FUSED:
            if kind in self.sensors:
                self._in_time(kind, self.sensors[kind])
        return self

    def _in_time(self, kind: Kind, sensor: Sensor) -> None:
        """A packet that is stale when it arrives would stop the robot for ever."""
        every_s = 1.0 / sensor.rate_hz
        if not sensor.delay_s + every_s < self.margins.stale_s:
            raise ValueError(
                f"sensors.{kind}.delay_s: found {sensor.delay_s}, and a packet every {every_s:.3g} s: together expected"
                f" below margins.stale_s {self.margins.stale_s}"
            )

    @model_validator(mode="after")
    def _motors_known(self) -> Self:
        for joint in self.joints:
            if joint.motor not in self.motors:
                raise ValueError(
                    f"joint {joint.name} names motor {joint.motor!r}; known: {', '.join(self.motors)}"
                )
        return self

    @model_validator(mode="after")
    def _locked_or_driven(self) -> Self:
        for name in self.locked:
            if name in self.joint_names or self.locked.count(name) > 1:
                raise ValueError(
                    f"locked: found {name!r}, expected each once and none that is listed in joints"
                )
        return self

    @model_validator(mode="after")
    def _all_driven_alike(self) -> Self:
        used = {joint.motor: self.motors[joint.motor].drive for joint in self.joints}
        without = [name for name, drive in used.items() if drive is None]
        if without and len(without) < len(used):
            raise ValueError(
                f"motors.{without[0]}.drive: missing, but other motors have one: expected one for all, or none and"
                " the drives of the model"
            )
        return self

    @model_validator(mode="after")
    def _margins_fit(self) -> Self:
        for joint in self.joints:
            if joint.q_max - joint.q_min <= 2 * self.margins.q_target_rad:
                raise ValueError(
                    f"margins.q_target_rad {self.margins.q_target_rad} leaves nothing of the range of {joint.name}"
                )
        return self

    @model_validator(mode="after")
    def _heat_ordered(self) -> Self:
        for name, motor in self.motors.items():
            if not motor.winding_soft_c < motor.winding_max_c - self.margins.winding_k:
                raise ValueError(
                    f"motors.{name}: winding_soft_c {motor.winding_soft_c} is not below winding_max_c"
                    f" {motor.winding_max_c} less margins.winding_k {self.margins.winding_k}"
                )
        return self

    @property
    def capabilities(self) -> frozenset[Capability]:
        """Optional parts that the robot has; declarations name those that they need."""
        parts: dict[Capability, object] = {
            "tool": self.tool,
            "workspace": self.workspace,
            "manipulability": self.margins.singularity,
            "floating_base": self.base,
            "self_collision": self.margins.collision_m,
        }
        return frozenset(name for name, part in parts.items() if part is not None)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in the order of every joint vector."""
        return tuple(joint.name for joint in self.joints)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def channels(self) -> dict[Kind, int]:
        """How many channels each sensor has, in the order of robot.toml."""
        return {kind: channels(kind, sensor, self.n) for kind, sensor in self.sensors.items()}

    @property
    def drives(self) -> tuple[Drive, ...]:
        """Of each joint; none where the model has drives of its own."""
        return tuple(drive for joint in self.joints if (drive := self.motors[joint.motor].drive) is not None)

    @property
    def dt(self) -> float:
        """s, the control period."""
        return 1.0 / self.rates.control_hz

    @property
    def stop_s(self) -> float:
        """s, the longest that a jerk-limited stop can take: from full speed, still at full acceleration.

        First the acceleration runs out, in a/j, adding a²/2j to the speed; losing v takes v/a + a/j.
        """
        qd, qdd, qddd = (self.joint_array(f"{name}_max") for name in ("qd", "qdd", "qddd"))
        return float((qd / qdd + 2.5 * qdd / qddd).max())

    @property
    def model_path(self) -> Path:
        """The model that both libraries read."""
        return self.folder / self.model

    @property
    def digest(self) -> str:
        """SHA-256 of what robot.toml and the model say, and of the meshes; layout and comments do not count."""
        xml = ET.canonicalize(ET.tostring(read_xml(self.model_path)), strip_text=True)
        text = self.model_dump_json(exclude={"folder"}, exclude_none=True) + xml
        for path in named_files(self.model_path, self.folder):
            with path.open("rb") as file:
                text += f"\n{path.relative_to(self.folder)} {hashlib.file_digest(file, 'sha256').hexdigest()}"
        return hashlib.sha256(text.encode()).hexdigest()

    def joint_array(self, field: str) -> NDArray[np.float64]:
        """(n,) one number of every joint, for example `qd_max`."""
        return np.array([getattr(joint, field) for joint in self.joints])

    def motor_array(self, field: str) -> NDArray[np.float64]:
        """(n,) one number of every joint's motor, for example `winding_max_c`."""
        return np.array([getattr(self.motors[joint.motor], field) for joint in self.joints])


class _RobotFile(RobotSpec):
    """robot.toml as it stands; the folder is where it was found, not a key."""

    folder: Path = Field(default=Path(), exclude=True)


def load_robot(robot: str | Path) -> RobotSpec:
    """Read a robot by its name in `robots/` or by the path of its folder.

    Raises:
        RobotError: no such robot, or a file of it is unreadable, misspelt or out of bounds.
    """
    folder = Path(robot)
    if not folder.is_dir():
        folder = ROBOTS / str(robot)
    if not (folder / "robot.toml").is_file():
        raise RobotError(f"--robot {robot}: no such folder with a robot.toml; known: {_known()}")
    file = read_toml(folder / "robot.toml", _RobotFile, RobotError)
    if "folder" in file.model_fields_set:
        raise RobotError(f"{folder / 'robot.toml'}: folder: unknown key")
    return RobotSpec.model_construct(**{**dict(file), "folder": folder.resolve()})


def _known() -> str:
    return ", ".join(sorted(path.parent.name for path in ROBOTS.glob("*/robot.toml")))
