"""How a robot of a kind may really be: the spans of draws.toml, read strictly, each inside what physics allows."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from robots.arrays import Floats
from robots.errors import ConfigError
from robots.sensors import BUFFER_S, LOSS_MAX, Kind, Sensor
from robots.spec import RobotSpec
from robots.strict import Strict, read_toml
from robots.tables import Celsius

COMMAND_DELAY_S = 0.005
"""s, the longest that a command may be under way to a drive."""


class Span(Strict):
    """Uniform in [low, high], or uniform in the logarithm."""

    low: float
    high: float
    log: bool = False

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low {self.low} is above high {self.high}")
        if self.log and self.low <= 0:
            raise ValueError(f"low {self.low} of a logarithmic span is not above 0")
        return self

    def sample(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
        """Numbers of a shape."""
        if self.log:
            return np.exp(rng.uniform(np.log(self.low), np.log(self.high), shape))
        return rng.uniform(self.low, self.high, shape)


@dataclass(frozen=True, slots=True)
class Quantity:
    """Something that differs from robot to robot.

    Attributes:
        low, high: what physics allows: a span or a draw that leaves it cannot be expressed.
        each: what of a robot has a number of its own: "joint", "sensor", "channel" (of its sensors), "axis" (of each
            joint's link), "direction" (x, y, z), "horizontal" (x, y); "" for the robot as a whole.
    """

    low: float
    high: float
    each: str

    def check(self, span: Span) -> Span:
        """Refuse a span that leaves what physics allows."""
        if not self.low <= span.low <= span.high <= self.high:
            raise ValueError(f"[{span.low}, {span.high}] is not inside [{self.low}, {self.high}]")
        return span


def _drawn(low: float, high: float, each: str = "") -> tuple[AfterValidator, Quantity]:
    quantity = Quantity(low, high, each)
    return AfterValidator(quantity.check), quantity


class Links(Strict):
    """Of each moving link: mass and inertia together, the way to the next joint, and where its mass sits.

    Inertia about the centre of mass is scaled with the mass, never drawn, so none of these leaves what a rigid body can
    have; a longer link keeps it, so lengths stay near 1.
    """

    mass: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    length: Annotated[Span, *_drawn(0.9, 1.1, "joint")]
    com_m: Annotated[Span, *_drawn(-0.2, 0.2, "axis")]


class Joints(Strict):
    """Of each joint: factors, and the play of its gear."""

    friction: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    damping: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    armature: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    backlash_rad: Annotated[Span, *_drawn(0.0, 0.05, "joint")]


class Drives(Strict):
    """Of each drive: factors. Of all: supply voltage as a factor, what the supply's lines resist, commands late.

    `resistance` is the windings' in ohm; heat goes `winding_to_housing` and `housing_to_ambient`, K/W, and stays in
    `winding_capacity` and `housing_capacity`, J/K.
    `delay_s` is taken as whole periods of physics.
    """

    kp: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    kd: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    torque_constant: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    resistance: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    winding_to_housing: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    winding_capacity: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    housing_to_ambient: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    housing_capacity: Annotated[Span, *_drawn(0.05, 20.0, "joint")]
    iron_loss: Annotated[Span, *_drawn(0.0, 20.0, "joint")]
    voltage: Annotated[Span, *_drawn(0.2, 2.0)]
    supply_ohm: Annotated[Span, *_drawn(0.0, 5.0)]
    delay_s: Annotated[Span, *_drawn(0.0, COMMAND_DELAY_S)]


class Mounting(Strict):
    """How it stands: out of plumb about x and y, and by what factor what touches it is rougher."""

    tilt_rad: Annotated[Span, *_drawn(-0.5, 0.5, "horizontal")]
    contact_friction: Annotated[Span, *_drawn(0.05, 20.0)]


class Payload(Strict):
    """What the tool picks up, carries and drops, again and again: a ball, `com_m` off the tool in its frame."""

    mass_kg: Annotated[Span, *_drawn(0.0, 50.0)]
    com_m: Annotated[Span, *_drawn(-0.5, 0.5, "direction")]
    carried_s: Annotated[Span, *_drawn(0.1, 1e6)]
    free_s: Annotated[Span, *_drawn(0.1, 1e6)]


class Cable(Strict):
    """A power cable: a spring that only pulls, from an anchor in the world to a link's centre of mass.

    Attributes:
        link: a body of model.xml. above_m: m, what the anchor is drawn around, above the world's origin.
    """

    link: str
    above_m: Annotated[float, Field(ge=-10, le=10)]
    stiffness_n_per_m: Annotated[Span, *_drawn(0.0, 1e4)]
    length_m: Annotated[Span, *_drawn(0.0, 10.0)]
    anchor_m: Annotated[Span, *_drawn(-10.0, 10.0, "direction")]


class Push(Strict):
    """Somebody bumps into a link, any of them: a force from anywhere at its centre of mass.

    `every_s` is the mean of the pause between two of them, which is exponential.
    """

    force_n: Annotated[Span, *_drawn(0.0, 1e4)]
    lasts_s: Annotated[Span, *_drawn(0.005, 10.0)]
    every_s: Annotated[Span, *_drawn(1.0, 1e6)]


class Wear(Strict):
    """What a joint has changed by when it has lived its life once: growth of factors, of play, of the encoder's error.

    In proportion to the life lived, which goes on beyond one.

    Attributes:
        life_rad: rad that a joint travels in its life at `life_c` of its winding; each 10 K more take it twice as
            fast, each 10 K less half as fast.
        life_c: °C, what a winding can be.
    """

    life_rad: Annotated[float, Field(ge=1)]
    life_c: Celsius
    friction: Annotated[Span, *_drawn(0.0, 20.0, "joint")]
    backlash_rad: Annotated[Span, *_drawn(0.0, 0.05, "joint")]
    encoder_rad: Annotated[Span, *_drawn(-0.1, 0.1, "joint")]
    torque_constant: Annotated[Span, *_drawn(-0.9, 0.0, "joint")]


class Climate(Strict):
    """Where the robot stands."""

    ambient_c: Annotated[Span, *_drawn(-40.0, 80.0)]
    warm_start_k: Annotated[Span, *_drawn(0.0, 100.0)]


class Lies(Strict):
    """How each sensor differs from its data sheet: factors of what robot.toml says, and how its packets travel.

    Attributes:
        noise, bias, drift, drift_per_k, loss: factors. delay: factor, the least delay. jitter: what is added to it
            at most, as a factor too. hold: probability, at each control tick, that the delay stays as it is. burst:
            control ticks in a row in which packets are lost, mean. repeat: share of ticks at which the last packet
            comes again, in the place of the one that is due.
    """

    noise: Annotated[Span, *_drawn(0.0, 20.0, "sensor")]
    bias: Annotated[Span, *_drawn(-20.0, 20.0, "channel")]
    drift: Annotated[Span, *_drawn(0.0, 20.0, "sensor")]
    drift_per_k: Annotated[Span, *_drawn(-20.0, 20.0, "channel")]
    delay: Annotated[Span, *_drawn(0.0, 20.0, "sensor")]
    jitter: Annotated[Span, *_drawn(0.0, 20.0, "sensor")]
    hold: Annotated[Span, *_drawn(0.0, 1.0, "sensor")]
    loss: Annotated[Span, *_drawn(0.0, 20.0, "sensor")]
    burst: Annotated[Span, *_drawn(1.0, 50.0, "sensor")]
    repeat: Annotated[Span, *_drawn(0.0, 0.5, "sensor")]


class Distributions(Strict):
    """draws.toml."""

    links: Links
    joints: Joints
    drives: Drives
    mounting: Mounting
    payload: Payload
    cable: Cable
    push: Push
    wear: Wear
    climate: Climate
    sensors: Lies

    @property
    def digest(self) -> str:
        """SHA-256 of the numbers."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()

    @property
    def fixed(self) -> dict[str, float | str]:
        """What is the same for every robot, by name as in "cable.link"."""
        return {
            f"{group}.{field}": value
            for group, table in self
            for field, value in table
            if not isinstance(value, Span)
        }

    def spans(self) -> Iterator[tuple[str, Quantity, Span]]:
        """Everything that is drawn: its name as in "links.mass", what it is, and how."""
        for group, table in self:
            for field, info in type(table).model_fields.items():
                for quantity in info.metadata:
                    if isinstance(quantity, Quantity):
                        yield f"{group}.{field}", quantity, getattr(table, field)


def load_distributions(spec: RobotSpec) -> Distributions:
    """Read the robot's draws.toml.

    Raises:
        ConfigError: unreadable, misspelt, outside what physics allows, or packets that travel longer than the buffer.
    """
    path = spec.folder / "draws.toml"
    distributions = read_toml(path, Distributions, ConfigError)
    lies = distributions.sensors
    for kind, sensor in spec.sensors.items():
        check_journey(kind, sensor, lies.delay.high + lies.jitter.high, lies.loss.high, str(path))
    return distributions


def check_journey(kind: Kind, sensor: Sensor, delay: float, loss: float, source: str) -> None:
    """Refuse factors of a sensor's delay and loss that the simulated bus cannot live.

    Raises:
        ConfigError: packets would travel longer than the buffer is, or more than half of them would be lost.
    """
    if sensor.delay_s * delay > BUFFER_S:
        raise ConfigError(
            f"{source}: sensors.delay and sensors.jitter: {kind} would take {sensor.delay_s * delay:g} s, at most"
            f" {BUFFER_S} s"
        )
    if sensor.loss * loss > LOSS_MAX:
        raise ConfigError(
            f"{source}: sensors.loss: {kind} would lose {sensor.loss * loss:g}, at most {LOSS_MAX}"
        )
