"""Distributions of draws.toml: the real dynamics, sensors and surroundings of robots of one kind.

Read strictly; each span lies inside the bounds that physics sets.
"""

import hashlib
from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from robots.errors import ConfigError
from robots.sensors import BUFFER_S, LOSS_MAX, Kind, Sensor
from robots.spans import Quantity, Span, bounded
from robots.spec import RobotSpec
from robots.strict import Strict, read_toml
from robots.tables import Celsius

COMMAND_DELAY_S = 0.005
"""s, the largest delay of a command on its way to a drive."""


class Links(Strict):
    """Factors of each moving link's mass (with its inertia) and length, and the offset of its centre of mass.

    Inertia about the centre of mass is scaled with the mass, never drawn, so that every draw is a possible rigid body;
    a longer link keeps its inertia, so lengths stay near 1.
    """

    mass: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    length: Annotated[Span, *bounded(0.9, 1.1, "joint")]
    com_m: Annotated[Span, *bounded(-0.2, 0.2, "axis")]


class Joints(Strict):
    """Factors of each joint's friction, damping and armature, and the play of its gear."""

    friction: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    damping: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    armature: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    backlash_rad: Annotated[Span, *bounded(0.0, 0.05, "joint")]


class Drives(Strict):
    """Factors of each drive; for all drives the supply's voltage (a factor), its resistance and the command delay.

    `resistance` is that of the winding, ohm; `winding_to_housing`, `housing_to_ambient` are thermal resistances, K/W;
    `winding_capacity` and `housing_capacity` are heat capacities, J/K.
    `delay_s` is rounded to whole periods of physics.
    """

    kp: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    kd: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    torque_constant: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    resistance: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    winding_to_housing: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    winding_capacity: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    housing_to_ambient: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    housing_capacity: Annotated[Span, *bounded(0.05, 20.0, "joint")]
    iron_loss: Annotated[Span, *bounded(0.0, 20.0, "joint")]
    voltage: Annotated[Span, *bounded(0.2, 2.0)]
    supply_ohm: Annotated[Span, *bounded(0.0, 5.0)]
    delay_s: Annotated[Span, *bounded(0.0, COMMAND_DELAY_S)]


class Mounting(Strict):
    """Tilt of the mounting about x and y, and a factor of the friction of all contacts."""

    tilt_rad: Annotated[Span, *bounded(-0.5, 0.5, "horizontal")]
    contact_friction: Annotated[Span, *bounded(0.05, 20.0)]


class Payload(Strict):
    """Ball that the tool carries for a while and drops, again and again; `com_m` from the tool, in its frame."""

    mass_kg: Annotated[Span, *bounded(0.0, 50.0)]
    com_m: Annotated[Span, *bounded(-0.5, 0.5, "direction")]
    carried_s: Annotated[Span, *bounded(0.1, 1e6)]
    free_s: Annotated[Span, *bounded(0.1, 1e6)]


class Cable(Strict):
    """Power cable: a spring that only pulls, from an anchor in the world to a link's centre of mass.

    Attributes:
        link: a body of model.xml. above_m: m, height of the point around which the anchor is drawn.
    """

    link: str
    above_m: Annotated[float, Field(ge=-10, le=10)]
    stiffness_n_per_m: Annotated[Span, *bounded(0.0, 1e4)]
    length_m: Annotated[Span, *bounded(0.0, 10.0)]
    anchor_m: Annotated[Span, *bounded(-10.0, 10.0, "direction")]


class Push(Strict):
    """Pushes: a force in a random direction on the centre of mass of a random link.

    `every_s` is the mean of the exponential pause between two of them.
    """

    force_n: Annotated[Span, *bounded(0.0, 1e4)]
    lasts_s: Annotated[Span, *bounded(0.005, 10.0)]
    every_s: Annotated[Span, *bounded(1.0, 1e6)]


class Wear(Strict):
    """Change of a joint over one service life: growth of factors, of play, of the encoder's error.

    In proportion to the share of its life that a joint has spent, which may exceed one.

    Attributes:
        life_rad: rad that a joint travels in one life at `life_c` of its winding; each 10 K more wear it twice as
            fast, each 10 K less half as fast.
        life_c: °C of the winding.
    """

    life_rad: Annotated[float, Field(ge=1)]
    life_c: Celsius
    friction: Annotated[Span, *bounded(0.0, 20.0, "joint")]
    backlash_rad: Annotated[Span, *bounded(0.0, 0.05, "joint")]
    encoder_rad: Annotated[Span, *bounded(-0.1, 0.1, "joint")]
    torque_constant: Annotated[Span, *bounded(-0.9, 0.0, "joint")]


class Climate(Strict):
    """Ambient temperature, and the housings' temperature above it at the start."""

    ambient_c: Annotated[Span, *bounded(-40.0, 80.0)]
    warm_start_k: Annotated[Span, *bounded(0.0, 100.0)]


class SensorErrors(Strict):
    """Difference of each sensor from its data sheet: factors of the values in robot.toml, and delays of its packets.

    Attributes:
        noise, bias, drift, drift_per_k, loss: factors. delay: factor, the least delay. jitter: the most that is added
            to it, as a factor too. hold: probability, at each control tick, that the delay stays as it is. burst:
            mean number of control ticks in a row in which packets are lost. repeat: share of ticks at which the last
            packet comes again, instead of the one that is due.
    """

    noise: Annotated[Span, *bounded(0.0, 20.0, "sensor")]
    bias: Annotated[Span, *bounded(-20.0, 20.0, "channel")]
    drift: Annotated[Span, *bounded(0.0, 20.0, "sensor")]
    drift_per_k: Annotated[Span, *bounded(-20.0, 20.0, "channel")]
    delay: Annotated[Span, *bounded(0.0, 20.0, "sensor")]
    jitter: Annotated[Span, *bounded(0.0, 20.0, "sensor")]
    hold: Annotated[Span, *bounded(0.0, 1.0, "sensor")]
    loss: Annotated[Span, *bounded(0.0, 20.0, "sensor")]
    burst: Annotated[Span, *bounded(1.0, 50.0, "sensor")]
    repeat: Annotated[Span, *bounded(0.0, 0.5, "sensor")]


class Distributions(Strict):
    """All of draws.toml."""

    links: Links
    joints: Joints
    drives: Drives
    mounting: Mounting
    payload: Payload
    cable: Cable
    push: Push
    wear: Wear
    climate: Climate
    sensors: SensorErrors

    @property
    def digest(self) -> str:
        """SHA-256 of the numbers."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()

    @property
    def fixed(self) -> dict[str, float | str]:
        """Values that are the same for every robot, by name as in "cable.link"."""
        return {
            f"{group}.{field}": value
            for group, table in self
            for field, value in table
            if not isinstance(value, Span)
        }

    def spans(self) -> Iterator[tuple[str, Quantity, Span]]:
        """Yield everything that is drawn: its name as in "links.mass", its bounds, its span."""
        for group, table in self:
            for field, info in type(table).model_fields.items():
                for quantity in info.metadata:
                    if isinstance(quantity, Quantity):
                        yield f"{group}.{field}", quantity, getattr(table, field)


def load_distributions(spec: RobotSpec) -> Distributions:
    """Read the robot's draws.toml; refuse (ConfigError) spans beyond physical bounds or the simulated bus."""
    path = spec.folder / "draws.toml"
    distributions = read_toml(path, Distributions, ConfigError)
    errors = distributions.sensors
    for kind, sensor in spec.sensors.items():
        check_transport(kind, sensor, errors.delay.high + errors.jitter.high, errors.loss.high, str(path))
    return distributions


def check_transport(kind: Kind, sensor: Sensor, delay: float, loss: float, source: str) -> None:
    """Refuse (ConfigError) delays longer than the simulated bus buffers, or losses above `LOSS_MAX`."""
    if sensor.delay_s * delay > BUFFER_S:
        raise ConfigError(
            f"{source}: sensors.delay and sensors.jitter: {kind} would take {sensor.delay_s * delay:g} s, at most"
            f" {BUFFER_S} s"
        )
    if sensor.loss * loss > LOSS_MAX:
        raise ConfigError(
            f"{source}: sensors.loss: {kind} would lose {sensor.loss * loss:g}, at most {LOSS_MAX}"
        )
