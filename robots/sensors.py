"""Sensors of robot.toml: the data sheet of each.

A sensor delivers packets: all of its channels, taken at one time. Deviations from the data sheet are in draws.toml.
"""

from typing import Annotated, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, PositiveInt, model_validator

from robots.strict import Name, NotNegative, Positive, Source, Strict

Place = Literal["joints", "site", "feet", "none"]
"""joints: one channel for each joint. site: one site of model.xml, in its frame. feet: one site at each foot. none: no
site."""


class SensorKind(NamedTuple):
    """Type of sensor: all that robot.toml, runtime and simulation know of it.

    Attributes:
        unit: of its readings. at: where it measures. channels: numbers at each joint or site.
        mujoco: MuJoCo's name of it, as in `mjSENS_GYRO`; None where the plant computes its readings.
        needed: every robot must have it, for joint state and heat.
    """

    unit: str
    at: Place
    channels: int = 1
    mujoco: str | None = None
    needed: bool = False


KINDS = {
    "encoder": SensorKind("rad", "joints", needed=True),
    "velocity": SensorKind("rad/s", "joints"),
    "current": SensorKind("A", "joints", needed=True),
    "temperature": SensorKind("degC", "joints", needed=True),
    "gyro": SensorKind("rad/s", "site", 3, "GYRO"),
    "accelerometer": SensorKind("m/s^2", "site", 3, "ACCELEROMETER"),
    "orientation": SensorKind("quat_wxyz", "site", 4, "FRAMEQUAT"),
    "force": SensorKind("N", "site", 3, "FORCE"),
    "torque": SensorKind("N*m", "site", 3, "TORQUE"),
    "contact": SensorKind("N", "feet", 1, "TOUCH"),
    "goal": SensorKind("m", "none", 3),
    "distance": SensorKind("m", "site"),
}
"""All types of sensors, each declared here only."""

NEEDED = tuple(name for name, kind in KINDS.items() if kind.needed)
AT_JOINTS = tuple(name for name, kind in KINDS.items() if kind.at == "joints")


def _known(name: str) -> str:
    if name not in KINDS:
        raise ValueError(f"expected one of {', '.join(map(repr, KINDS))}")
    return name


Kind = Annotated[str, AfterValidator(_known)]
"""Name of a type of sensor, a key of `KINDS`."""

BUFFER_S = 0.25
"""s, the largest delay of a packet in simulation."""

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
        range: the largest reading, either way: values beyond it read as this. Encoders of joints without ends count
            turns, and have no largest reading.
        noise: standard deviation of a reading.
        bias: the largest constant error.
        drift: standard deviation of a bias' random walk after an hour.
        drift_per_k: the most that a bias moves, either way, for each K that the nearest housing has warmed.
        delay_s: s, from measurement to arrival.
        loss: share of packets that never arrive.
        source: where the numbers come from, or "estimate".
    """

    unit: str
    sites: tuple[Name, ...] = ()
    rate_hz: PositiveInt
    resolution: Positive
    range: Positive
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


FEET_MAX = 16
"""Feet of a robot, and sites of its contact sensor."""
SITES = {"site": (1, 1, "one"), "feet": (1, FEET_MAX, f"1 to {FEET_MAX}")}
"""Number of a sensor's sites, by place: least, most, and both as text; elsewhere none."""

Sensors = dict[Kind, Sensor]
"""By kind, in the order of robot.toml: the order of their channels."""


def channels(kind: Kind, sensor: Sensor, joints: int) -> int:
    """Return the number of channels, which is that of the numbers in a packet."""
    places = {"joints": joints, "feet": len(sensor.sites)}
    return KINDS[kind].channels * places.get(KINDS[kind].at, 1)


def check_sensors(sensors: Sensors, control_hz: int) -> None:
    """Refuse (ValueError) sensors that are missing, in another unit, at wrong sites, or faster than `control_hz`."""
    for kind in NEEDED:
        if kind not in sensors:
            raise ValueError(f"sensors: no {kind}; found {', '.join(sensors) or 'none'}")
    for kind, sensor in sensors.items():
        if sensor.unit != (unit := KINDS[kind].unit):
            raise ValueError(f"sensors.{kind}.unit: found {sensor.unit!r}, expected {unit!r}")
        least, most, expected = SITES.get(KINDS[kind].at, (0, 0, "none"))
        if not least <= len(sensor.sites) <= most:
            raise ValueError(f"sensors.{kind}.sites: found {list(sensor.sites)}, expected {expected}")
        if sensor.rate_hz > control_hz:
            raise ValueError(
                f"sensors.{kind}.rate_hz: found {sensor.rate_hz}, expected at most control_hz {control_hz}"
            )
