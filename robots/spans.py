"""Spans from which properties are drawn, and the bounds that physics sets to them."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from pydantic import AfterValidator, model_validator

from robots.arrays import Floats
from robots.strict import Strict


class Span(Strict):
    """Uniform distribution on [low, high], or uniform in the logarithm."""

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
        """Return random numbers of a shape."""
        if self.log:
            return np.exp(rng.uniform(np.log(self.low), np.log(self.high), shape))
        return rng.uniform(self.low, self.high, shape)

    @property
    def median(self) -> float:
        """The middle of the span; of a logarithmic one, by its logarithm."""
        return float(np.sqrt(self.low * self.high)) if self.log else (self.low + self.high) / 2


@dataclass(frozen=True, slots=True)
class Quantity:
    """Property that differs from robot to robot.

    Attributes:
        low, high: bounds that physics sets: a span or a draw beyond them is refused.
        each: the parts of a robot that have a number of their own: "joint", "sensor", "channel" (of its sensors),
            "axis" (of each joint's link), "direction" (x, y, z), "horizontal" (x, y); "" for the robot as a whole.
    """

    low: float
    high: float
    each: str

    def check(self, span: Span) -> Span:
        """Refuse a span that leaves the bounds."""
        if not self.low <= span.low <= span.high <= self.high:
            raise ValueError(f"[{span.low}, {span.high}] is not inside [{self.low}, {self.high}]")
        return span


def bounded(low: float, high: float, each: str = "") -> tuple[AfterValidator, Quantity]:
    """Return what a field of type `Span` is annotated with: the check of its bounds, and the quantity."""
    quantity = Quantity(low, high, each)
    return AfterValidator(quantity.check), quantity
