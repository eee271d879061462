"""The judge's limits beside robot.toml: limits.toml in the robot's folder, read strictly.

`deploy` cannot read them, so that nothing is tuned to them. They are not part of the robot's digest.
"""

import hashlib

import numpy as np

from robots.arrays import Floats
from robots.errors import ConfigError
from robots.spec import RobotSpec
from robots.strict import Positive, Source, Strict, read_toml


class MotorLimits(Strict):
    """Limits of each joint with one type of motor.

    Attributes:
        power_w: W, mechanical.
        torque_rate: N·m/s, of the feed-forward torque sent.
        source: of the numbers.
    """

    power_w: Positive
    torque_rate: Positive
    source: Source


class Limits(Strict):
    """Limits of one robot.

    Attributes:
        power_w: W, mechanical, all joints together.
        contact_n: N, normal force of any one contact.
        nees: squared error of the estimated angle, in variances of the estimate.
        deviations: distance of an observed number from its mean in training, in standard deviations.
        arming_rad: rad, distance of the first angle sent from the true angle.
        manipulability: m³ (six joints), the least that is not too near a singularity; given exactly if the robot has
            the capability of that name.
        motors: by the names of robot.toml.
    """

    power_w: Positive
    contact_n: Positive
    nees: Positive
    deviations: Positive
    arming_rad: Positive
    manipulability: Positive | None = None
    motors: dict[str, MotorLimits]

    @property
    def digest(self) -> str:
        """SHA-256 of the contents, without layout and comments."""
        return hashlib.sha256(self.model_dump_json(exclude_none=True).encode()).hexdigest()

    def motor_array(self, field: str, spec: RobotSpec) -> Floats:
        """(n,) one field of every joint's motor, for example `power_w`."""
        return np.array([getattr(self.motors[joint.motor], field) for joint in spec.joints])


def load_limits(spec: RobotSpec) -> Limits:
    """Read the robot's limits.toml.

    Raises:
        ConfigError: unreadable, misspelt, or not for the motors and capabilities of robot.toml.
    """
    path = spec.folder / "limits.toml"
    limits = read_toml(path, Limits, ConfigError)
    if limits.motors.keys() != spec.motors.keys():
        found, expected = (", ".join(sorted(motors)) for motors in (limits.motors, spec.motors))
        raise ConfigError(f"{path}: motors: found {found}, expected {expected}")
    needed, present = "manipulability" in spec.capabilities, limits.manipulability is not None
    if needed != present:
        found, expected, has = ("one", "none", "no ") if present else ("none", "one", "")
        raise ConfigError(
            f"{path}: manipulability: found {found}, expected {expected}: robot.toml has {has}margins.singularity"
        )
    return limits
