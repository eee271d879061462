"""Capsules of robot.toml: the shapes that stand for links in collision checks."""

from typing import Self

import numpy as np
from pydantic import PositiveFloat, model_validator

from robots.strict import Strict

Point = tuple[float, float, float]


class Capsule(Strict):
    """All points nearer than `radius` to the line from `start` to `end`, m, in the frame of `body`."""

    body: str
    start: Point
    end: Point
    radius: PositiveFloat

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        if np.allclose(self.start, self.end, rtol=0.0, atol=1e-6):
            raise ValueError(f"start and end are both {list(self.start)}, expected a line between them")
        return self
