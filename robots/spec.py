"""Specification of a robot: `robot.toml` beside `model.xml`, read strictly.

model.xml holds geometry, inertia, mechanical joint range, torque range, and constants of drives that it has itself.
"""

import hashlib
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from robots.arrays import Bools
from robots.capabilities import Capability
from robots.contacts import GOAL
from robots.errors import RobotError, is_utf8
from robots.models.files import read_xml, referenced_files
from robots.motors.control_mode import ControlMode
from robots.robot_file import RobotFile
from robots.sensors import Kind, channels
from robots.strict import read_toml
from robots.tables import Drive

ROBOTS = Path(__file__).parent


class RobotSpec(RobotFile):
    """Robot: contents of robot.toml, and what follows from them.

    Attributes:
        folder: absolute path of the folder of robot.toml and the model.
    """

    folder: Path

    @property
    def capabilities(self) -> frozenset[Capability]:
        """Names of the optional parts that the robot has."""
        parts: dict[Capability, object] = {
            "tool": self.tool,
            "workspace": self.workspace,
            "manipulability": self.margins.singularity,
            "floating_base": self.base,
            "self_collision": self.margins.collision_m,
            "allowed_contact": next((pair for pair in self.may_touch if pair.force_n is not None), None),
        }
        return frozenset(name for name, part in parts.items() if part is not None)

    @property
    def current_loops(self) -> Bools:
        """(n,) joints whose drives close a loop around the current: without one they could not follow torques."""
        return np.array(["torque" in self.motors[joint.motor].modes for joint in self.joints])

    def in_mode(self, mode: ControlMode) -> Self:
        """Return the robot with the margins of a control mode."""
        return self.model_copy(update={"margins": self.margins.of(mode)})

    @property
    def touches_goal(self) -> bool:
        """True if some body may touch the task's goal."""
        return any(GOAL in pair.bodies for pair in self.may_touch)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def pose_range(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) rad each, ends of a range with every pose: the working range, or a turn around home without one."""
        low, high, home = (self.joint_array(f"q_{end}") for end in ("min", "max", "home"))
        return np.where(np.isinf(low), home - np.pi, low), np.where(np.isinf(high), home + np.pi, high)

    @property
    def channels(self) -> dict[Kind, int]:
        """Number of channels of each sensor, in the order of robot.toml."""
        return {kind: channels(kind, sensor, self.n) for kind, sensor in self.sensors.items()}

    @property
    def drives(self) -> tuple[Drive, ...]:
        """Drive of each joint; empty where the model has drives of its own."""
        return tuple(drive for joint in self.joints if (drive := self.motors[joint.motor].drive) is not None)

    @property
    def dt(self) -> float:
        """s, the control period."""
        return 1.0 / self.rates.control_hz

    @property
    def stop_s(self) -> float:
        """s, the longest time of a jerk-limited stop: from full speed at full acceleration.

        First the acceleration goes to zero, in a/j, adding a²/2j to the speed; losing v takes v/a + a/j.
        """
        qd, qdd, qddd = (self.joint_array(f"{name}_max") for name in ("qd", "qdd", "qddd"))
        return float((qd / qdd + 2.5 * qdd / qddd).max())

    @property
    def model_path(self) -> Path:
        """Path of the model that both libraries read."""
        return self.folder / self.model

    @property
    def digest(self) -> str:
        """SHA-256 of the contents of robot.toml, model and meshes; layout and comments do not count."""
        xml = ET.canonicalize(ET.tostring(read_xml(self.model_path)), strip_text=True)
        text = self.model_dump_json(exclude={"folder"}, exclude_none=True) + xml
        for path in referenced_files(self.model_path, self.folder):
            with path.open("rb") as file:
                text += f"\n{path.relative_to(self.folder)} {hashlib.file_digest(file, 'sha256').hexdigest()}"
        return hashlib.sha256(text.encode()).hexdigest()

    def check_known(self, field: str, found: str, expected: str, names: Iterable[str]) -> None:
        """Refuse (RobotError) a name in robot.toml that is not among the names of the model's parts."""
        if found not in (known := [name for name in names if name]):
            raise RobotError(
                f"{self.folder / 'robot.toml'}: {field}: found {found!r}, expected {expected} of"
                f" {self.model_path.name}: {', '.join(known)}"
            )

    def joint_array(self, field: str) -> NDArray[np.float64]:
        """Return (n,) one number of every joint, for example `qd_max`."""
        return np.array([getattr(joint, field) for joint in self.joints])

    def motor_array(self, field: str) -> NDArray[np.float64]:
        """Return (n,) one number of every joint's motor, for example `winding_max_c`."""
        return np.array([getattr(self.motors[joint.motor], field) for joint in self.joints])


def load_robot(robot: str | Path, option: str = "--robot") -> RobotSpec:
    """Read a robot by its name in `robots/` or by the path of its folder.

    Raises:
        RobotError: names what is wrong in the folder, or the `option` or field that said `robot`.
    """
    folder = Path(robot)
    if not os.path.isdir(folder):  # False, and no error, for a name that is too long
        folder = ROBOTS / str(robot)
    if not os.path.isfile(folder / "robot.toml"):
        raise RobotError(f"{option} {robot}: no such folder with a robot.toml; known: {_known()}")
    if not is_utf8(str(folder.resolve())):
        raise RobotError(f"{option} {robot}: found a name that is not UTF-8")
    file = read_toml(folder / "robot.toml", RobotFile, RobotError)
    return RobotSpec.model_construct(**dict(file), folder=folder.resolve())


def _known() -> str:
    return ", ".join(sorted(path.parent.name for path in ROBOTS.glob("*/robot.toml")))
