"""How a robot of a kind may really be: distributions in draws.toml, and the draw that one robot gets.

A draw is plain data: stored, it re-creates its robot exactly. The runtime in `deploy` never sees one.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, model_validator

from robots.errors import ConfigError
from robots.spec import RobotSpec
from robots.strict import Strict, read_toml

Floats = NDArray[np.float64]


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

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """(size,) numbers."""
        if self.log:
            return np.exp(rng.uniform(np.log(self.low), np.log(self.high), size))
        return rng.uniform(self.low, self.high, size)


def _inside(low: float, high: float) -> AfterValidator:
    """What physics allows: a span that leaves [low, high] cannot be expressed."""

    def check(span: Span) -> Span:
        if not low <= span.low <= span.high <= high:
            raise ValueError(f"[{span.low}, {span.high}] is not inside [{low}, {high}]")
        return span

    return AfterValidator(check)


Factor = Annotated[Span, _inside(0.05, 20.0)]


class Factors(Strict):
    """Multiples of the nominal value, one draw per joint (mass and inertia: per moving link)."""

    mass: Factor
    friction: Factor
    damping: Factor
    armature: Factor
    kp: Factor
    kd: Factor
    torque_constant: Factor
    resistance: Factor


class Sensors(Strict):
    """What the encoder bus does, one draw per robot."""

    noise_rad: Annotated[Span, _inside(0.0, 0.2)]
    delay_s: Annotated[Span, _inside(0.0, 0.1)]
    loss: Annotated[Span, _inside(0.0, 0.5)]


class Climate(Strict):
    """Where the robot stands, one draw per robot."""

    ambient_c: Annotated[Span, _inside(-40.0, 80.0)]
    warm_start_k: Annotated[Span, _inside(0.0, 100.0)]


class Distributions(Strict):
    """draws.toml."""

    factors: Factors
    sensors: Sensors
    climate: Climate

    @property
    def digest(self) -> str:
        """SHA-256 of the numbers."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class Draw:
    """B robots as they really are.

    Attributes:
        mass, friction, damping, armature, kp, kd, torque_constant, resistance: (B, n) factors.
        noise_rad: (B,) rad. delay_s: (B,) s. loss: (B,) share of packets.
        ambient_c: (B,) °C. warm_start_k: (B,) K, housing above ambient at the start.
    """

    mass: Floats
    friction: Floats
    damping: Floats
    armature: Floats
    kp: Floats
    kd: Floats
    torque_constant: Floats
    resistance: Floats
    noise_rad: Floats
    delay_s: Floats
    loss: Floats
    ambient_c: Floats
    warm_start_k: Floats


def load_distributions(spec: RobotSpec) -> Distributions:
    """Read the robot's draws.toml.

    Raises:
        ConfigError: unreadable, misspelt, or outside what physics allows.
    """
    return read_toml(spec.folder / "draws.toml", Distributions, ConfigError)


def draw(distributions: Distributions, n: int, seeds: Sequence[np.random.SeedSequence]) -> Draw:
    """One robot for each seed.

    Args:
        distributions: the spans.
        n: joints.
        seeds: B seeds, as `robots.randomness.robot_seed` gives them.
    """
    robots = [_one(distributions, n, np.random.default_rng(seed)) for seed in seeds]
    return Draw(**{field.name: np.stack([robot[field.name] for robot in robots]) for field in fields(Draw)})


def _one(distributions: Distributions, n: int, rng: np.random.Generator) -> dict[str, Floats]:
    sampled = {name: span.sample(rng, n) for name, span in distributions.factors}
    for group in (distributions.sensors, distributions.climate):
        sampled |= {name: span.sample(rng, 1)[0] for name, span in group}
    return sampled
