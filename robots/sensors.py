"""Sensors of robot.toml: the data sheet of each.

A sensor delivers packets: all of its channels, taken at one time. Deviations from the data sheet are in draws.toml.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from robots.strict import Source, Strict

Kind = Literal[
    "encoder",
    "velocity",
    "current",
    "temperature",
    "gyro",
    "accelerometer",
    "orientation",
    "force",
    "torque",
    "contact",
    "goal",
]

UNITS: dict[Kind, str] = {
    "encoder": "rad",
    "velocity": "rad/s",
    "current": "A",
    "temperature": "degC",
    "gyro": "rad/s",
    "accelerometer": "m/s^2",
    "orientation": "quat_wxyz",
    "force": "N",
    "torque": "N*m",
    "contact": "N",
    "goal": "m",
}
"""Unit of each kind."""

AT_JOINTS: tuple[Kind, ...] = ("encoder", "velocity", "current", "temperature")
"""One channel for each joint."""
AT_ONE_SITE: tuple[Kind, ...] = ("gyro", "accelerometer", "orientation", "force", "torque")
"""Sensors at one site of model.xml, in its frame: three channels, four for an orientation."""
NEEDED: tuple[Kind, ...] = ("encoder", "current", "temperature")
"""Sensors that every robot must have: for joint state and heat."""

BUFFER_S = 0.25
"""s, the largest delay of a packet in simulation."""

NotNegative = Annotated[float, Field(ge=0)]
Delay = Annotated[float, Field(ge=0, lt=BUFFER_S)]
LOSS_MAX = 0.5
"""The largest share of packets that may be lost in simulation."""
Loss = Annotated[float, Field(ge=0, le=LOSS_MAX)]


class Sensor(Strict):
    """The data sheet of one sensor.

    Attributes:
        unit: of what it measures, and of the numbers below.
        sites: of model.xml: one for inertial sensors, force and torque, one at each foot for contact, none for the
            others.
        rate_hz: packets per second.
        resolution: the step between two readings.
        range: the largest reading, either way: values beyond it read as this.
        noise: standard deviation of a reading.
        bias: the largest constant error.
        drift: standard deviation of a bias' random walk after an hour.
        drift_per_k: the most that a bias moves, either way, for each K that the nearest housing has warmed.
        delay_s: s, from measurement to arrival.
        loss: share of packets that never arrive.
        source: where the numbers come from, or "estimate".
    """

    unit: str
    sites: tuple[str, ...] = ()
    rate_hz: PositiveInt
    resolution: PositiveFloat
    range: PositiveFloat
    noise: NotNegative
    bias: NotNegative
    drift: NotNegative
    drift_per_k: NotNegative
    delay_s: Delay
    loss: Loss
    source: Source

    @model_validator(mode="after")
    def _range_above_resolution(self) -> Self:
        if self.resolution >= self.range:
            raise ValueError(f"resolution {self.resolution} is not below range {self.range}")
        return self

    @property
    def variance(self) -> float:
        """Variance of a reading: noise and resolution. Source: Widrow and Kollár, Quantization Noise (2008), ch. 4."""
        return self.noise**2 + self.resolution**2 / 12.0


Sensors = dict[Kind, Sensor]
"""By kind, in the order of robot.toml: the order of their channels."""


def channels(kind: Kind, sensor: Sensor, joints: int) -> int:
    """Return the number of channels, which is that of the numbers in a packet."""
    if kind in AT_JOINTS:
        return joints
    if kind == "contact":
        return len(sensor.sites)
    return 4 if kind == "orientation" else 3


def check_sensors(sensors: Sensors, control_hz: int) -> None:
    """Check the sensors of a robot against each other and the control rate.

    Raises:
        ValueError: one is missing, in another unit, at no site or at too many, or faster than the control rate.
    """
    for kind in NEEDED:
        if kind not in sensors:
            raise ValueError(f"sensors: no {kind}; found {', '.join(sensors) or 'none'}")
    for kind, sensor in sensors.items():
        if sensor.unit != UNITS[kind]:
            raise ValueError(f"sensors.{kind}.unit: found {sensor.unit!r}, expected {UNITS[kind]!r}")
        least, most, expected = _sites(kind)
        if not least <= len(sensor.sites) <= most:
            raise ValueError(f"sensors.{kind}.sites: found {list(sensor.sites)}, expected {expected}")
        if sensor.rate_hz > control_hz:
            raise ValueError(
                f"sensors.{kind}.rate_hz: found {sensor.rate_hz}, expected at most control_hz {control_hz}"
            )


def _sites(kind: Kind) -> tuple[float, float, str]:
    """Return the number of a sensor's sites: least, most, and both as text."""
    if kind == "contact":
        return 1, math.inf, "at least one"
    return (1, 1, "one") if kind in AT_ONE_SITE else (0, 0, "none")
