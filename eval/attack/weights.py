"""Weights of the policies that an attack searches over: one small graph that holds every adversary of the library.

In each step, of joints with angle q and speed v (a share of its limit), at time t since arming:

    drive  = damping·v + dither·sin(dither_rate·q) + wave·sin 2π(wave_hz·t + chirp·t²/2 + wave_turns)
           + swing·sin 2π(swing_hz·t + swing_turns) + push + step·sign(t - step_s) + spring·(home - q)
           + replay·(command `delay` steps ago) + network
    command = tanh(sharpness·drive)
    target = centre + reach·command, but no number in the step at `refused_s`, which leads to a stop

The network has one hidden layer and sees the distance from home, v and the delayed command. The centre is `follow`
times the joint's angle and 1 - `follow` times its home in position mode, else 0; the spring is of the other modes.

An adversary of a pushed arm (`pushed_arm.py`) has weights beside the graph: the moment of its push, in s after
`refused_s`, its direction, the moment at which its samples are oldest, likewise, and the gains of its drives.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robots.arrays import Floats

HIDDEN = 4
"""Width of the network's hidden layer."""
DELAY_MAX = 20
"""Policy steps of the longest delay: 0.1 s at 200 Hz."""
DIGITS = 4
"""Significant digits of a weight: what is tried is what a file holds."""

Weights = Mapping[str, tuple[float, ...]]
"""Weights by name: the numbers of each, row by row; those that are not given are at rest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Weight:
    """One kind of weight.

    Attributes:
        low, high: bounds of the search. log: steps of the search are factors. rest: value where it is not searched.
        shape: "n" joints, "h" hidden units, "i" inputs of the network, "x" axes of the world; empty for one number.
        whole: an integer.
    """

    low: float
    high: float
    log: bool = False
    rest: float = 0.0
    shape: str = "n"
    whole: bool = False

    def shape_of(self, joints: int) -> tuple[int, ...]:
        """Return the shape for a robot of n joints."""
        sizes = {"n": joints, "h": HIDDEN, "i": 3 * joints, "x": 3}
        return tuple(sizes[axis] for axis in self.shape)

    def size(self, joints: int) -> int:
        """Return the number of numbers for a robot of n joints."""
        return math.prod(self.shape_of(joints))

    def decoded(self, shares: Floats) -> Floats:
        """Return weights (N,) for shares from 0 to 1 of the way from `low` to `high`."""
        span = self.high - self.low
        value = self.low * (self.high / self.low) ** shares if self.log else self.low + span * shares
        return np.round(value) if self.whole else _rounded(value)

    def encoded(self, value: Floats) -> Floats:
        """Return the share of weights; `decoded` undoes it."""
        if self.log:
            return np.asarray(np.log(value / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)


GRAPH_WEIGHTS: Mapping[str, Weight] = {
    "reach": Weight(low=0.02, high=3.0, log=True, rest=1.0),
    "sharpness": Weight(low=0.3, high=300.0, log=True, rest=1.0, shape=""),
    "follow": Weight(low=0.0, high=1.0, rest=1.0, shape=""),
    "damping": Weight(low=-3.0, high=3.0),
    "dither": Weight(low=0.0, high=1.0),
    "dither_rate": Weight(low=10.0, high=3000.0, log=True, rest=977.0, shape=""),
    "wave": Weight(low=-2.0, high=2.0),
    "wave_hz": Weight(low=0.1, high=100.0, log=True, rest=1.0),
    "wave_turns": Weight(low=0.0, high=1.0),
    "chirp": Weight(low=-10.0, high=10.0, shape=""),
    "swing": Weight(low=-2.0, high=2.0),
    "swing_hz": Weight(low=0.05, high=3.0, log=True, rest=0.5, shape=""),
    "swing_turns": Weight(low=0.0, high=1.0),
    "push": Weight(low=-2.0, high=2.0),
    "step": Weight(low=-2.0, high=2.0),
    "step_s": Weight(low=0.3, high=3.5),
    "spring": Weight(low=0.0, high=2.0),
    "refused_s": Weight(low=0.7, high=4.2, rest=-1.0, shape=""),
    "replay": Weight(low=-2.0, high=2.0),
    "delay": Weight(low=1.0, high=DELAY_MAX, rest=1.0, shape="", whole=True),
    "inward": Weight(low=-3.0, high=3.0, shape="ih"),
    "bias": Weight(low=-2.0, high=2.0, shape="h"),
    "outward": Weight(low=-2.0, high=2.0, shape="hn"),
}
"""Weights of the graph. Lengths are in rad of position mode, else in shares of the limit of what drives follow."""

ARM_WEIGHTS: Mapping[str, Weight] = {
    "force_s": Weight(low=-0.3, high=0.3, shape=""),
    "lost_s": Weight(low=-0.3, high=0.3, shape=""),
    "force_toward": Weight(low=-1.0, high=1.0, shape="x"),
    "stiffness": Weight(low=0.0, high=1.0),
    "damping_of_drive": Weight(low=0.0, high=1.0),
}
"""Weights of a pushed arm beside its graph; gains are shares of the bounds of a contract's."""

WEIGHTS: Mapping[str, Weight] = {**GRAPH_WEIGHTS, **ARM_WEIGHTS}
"""Weights of both kinds."""


def arrays(rows: Sequence[Weights], joints: int) -> dict[str, Floats]:
    """Return the weights of R graphs for a robot of n joints, each (R, *its shape)."""
    return {
        name: np.array(
            [row.get(name, [kind.rest] * kind.size(joints)) for row in rows], dtype=np.float64
        ).reshape(len(rows), *kind.shape_of(joints))
        for name, kind in GRAPH_WEIGHTS.items()
    }


def _rounded(values: Floats) -> Floats:
    """Return values (N,) with `DIGITS` significant digits."""
    return np.array([float(f"{x:.{DIGITS}g}") for x in values])
