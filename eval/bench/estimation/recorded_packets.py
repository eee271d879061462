"""What the estimator's bench is about: what robots did, and what was heard of it."""

from dataclasses import dataclass

import numpy as np

from robots.arrays import Floats
from robots.draws import Draw


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """What B robots really did and what their encoders saw of it, at the ticks of the runtime.

    Attributes:
        q, qd: (T, B, n) rad and rad/s. seen: (T, B, n) rad, where the encoders sit.
        sent: (T, B, 2n) setpoints that the drives should have reached.
        draw, seeds: whose encoders watched.
    """

    q: Floats
    qd: Floats
    seen: Floats
    sent: Floats
    draw: Draw
    seeds: list[np.random.SeedSequence]

    @property
    def robots(self) -> int:
        """B."""
        return len(self.seeds)


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """What was made of it (T, B, n): rad and rad/s, and the estimate's `nees`."""

    raw: Floats
    differenced: Floats
    q: Floats
    qd: Floats
    nees: Floats
