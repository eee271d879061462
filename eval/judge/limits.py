"""What the judge holds a robot to beside its robot.toml: limits.toml in the robot's folder, read strictly.

They are the judge's own: `deploy` cannot read them, so that nothing is tuned to them, and they are no part of the
robot's digest.
"""

import hashlib

import numpy as np
from numpy.typing import NDArray
from pydantic import PositiveFloat

from robots.errors import ConfigError
from robots.spec import RobotSpec
from robots.strict import Source, Strict, read_toml


class MotorLimits(Strict):
    """Of each joint that a motor drives.

    Attributes:
        power_w: W, mechanical.
        torque_rate: N·m/s, of the feed-forward torque that is sent.
        source: where the numbers come from.
    """

    power_w: PositiveFloat
    torque_rate: PositiveFloat
    source: Source


class Limits(Strict):
    """Of one robot.

    Attributes:
        power_w: W, mechanical, all joints together.
        contact_n: N, normal force of any one contact.
        nees: squared error of the estimated angle, in variances of the estimate.
        deviations: standard deviations of the training by which a number of the observation may lie off its mean.
        arming_rad: rad, by which the first angle sent may miss where the joint truly stands.
        manipulability: m³ (six joints), the least that is not too near a singularity; of robots with a tool.
        motors: by the names of robot.toml.
    """

    power_w: PositiveFloat
    contact_n: PositiveFloat
    nees: PositiveFloat
    deviations: PositiveFloat
    arming_rad: PositiveFloat
    manipulability: PositiveFloat | None = None
    motors: dict[str, MotorLimits]

    @property
    def digest(self) -> str:
        """SHA-256 of what the file says."""
        return hashlib.sha256(self.model_dump_json(exclude_none=True).encode()).hexdigest()

    def motor_array(self, field: str, spec: RobotSpec) -> NDArray[np.float64]:
        """(n,) one number of every joint's motor, for example `power_w`."""
        return np.array([getattr(self.motors[joint.motor], field) for joint in spec.joints])


def load_limits(spec: RobotSpec) -> Limits:
    """Read the robot's limits.toml.

    Raises:
        ConfigError: unreadable, misspelt, or not of the motors of robot.toml.
    """
    path = spec.folder / "limits.toml"
    limits = read_toml(path, Limits, ConfigError)
    if limits.motors.keys() != spec.motors.keys():
        found, expected = (", ".join(sorted(motors)) for motors in (limits.motors, spec.motors))
        raise ConfigError(f"{path}: motors: found {found}, expected {expected}")
    if (limits.manipulability is None) != (spec.tooling is None):
        found, expected = ("one", "none of a robot with a base") if spec.base else ("none", "one")
        raise ConfigError(f"{path}: manipulability: found {found}, expected {expected}")
    return limits
