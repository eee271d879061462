"""Library of adversaries: where searches start, and which weights each of them searches."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from eval.attack.weights import WEIGHTS, Weights
from robots.arrays import Floats
from robots.motors.control_mode import ControlMode

Effect = Literal["load", "sag", "throw", "tool"]
"""Effect of a push: it adds to the torque that extra mass and payload take, or to what drives yield to them, throws the
link of one joint through the play of its gear, or all links and with them the tool."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Adversary:
    """A kind of policy that does harm.

    Attributes:
        name: in the library. meaning: for reports.
        start: weights, the same for all joints. Others that are searched start in the middle of their bounds.
        searched: names of the weights that a search changes.
        effect: of a push, by which one arm is chosen (`pushed_arm.py`); None: it moves the robots of a seed.
        targets: monitors that are searched for on such an arm, by one search each; twice is by two, for two joints.
    """

    name: str
    meaning: str
    start: Mapping[str, float]
    searched: tuple[str, ...]
    effect: Effect | None = None
    targets: tuple[str, ...] = ()

    def first(self, joints: int) -> Weights:
        """Return the weights at which searches start, for a robot of n joints."""
        return {name: (x,) * WEIGHTS[name].size(joints) for name, x in self._everywhere().items()}

    def searching(self, *names: str, **start: float) -> "Adversary":
        """Return the adversary with other searched weights and starts; the others keep the values they start from."""
        return replace(self, searched=names, start={**self._everywhere(), **start})

    def _everywhere(self) -> dict[str, float]:
        middle = {name: float(WEIGHTS[name].decoded(np.array([0.5]))[0]) for name in self.searched}
        return {**middle, **self.start}

    def varied(
        self, joints: int, rng: np.random.Generator, deviation: float, number: int
    ) -> tuple[Weights, ...]:
        """Return the first weights varied at random, by a standard deviation in shares of the bounds."""
        first = self.shares(self.first(joints))
        shares = np.clip(rng.normal(first, deviation, (number, len(first))), 0.0, 1.0)
        return tuple(self.weights(each, joints) for each in shares)

    def shares(self, weights: Weights) -> Floats:
        """(D,) the searched weights as shares of their bounds, from 0 to 1."""
        return np.concatenate([WEIGHTS[name].encoded(np.array(weights[name])) for name in self.searched])

    def weights(self, shares: Floats, joints: int) -> Weights:
        """Return the weights at shares (D,)."""
        ends = np.cumsum([WEIGHTS[name].size(joints) for name in self.searched])[:-1]
        parts = zip(self.searched, np.split(shares, ends), strict=True)
        found = {name: tuple(WEIGHTS[name].decoded(part).tolist()) for name, part in parts}
        return {**self.first(joints), **found}


POSES = ("push", "step", "step_s", "refused_s", "force_s", "force_toward", "lost_s")
GAINS, LAW = ("stiffness", "damping_of_drive"), ("reach", "spring", "damping")
"""Weights that pushed arms search: poses with a stop, a push and lost packets, gains of a contract, and the law of a
policy of torques."""


def _pushed(
    name: str, meaning: str, *, effect: Effect, targets: tuple[str, ...], **start: float
) -> Adversary:
    """Return an adversary of a pushed arm, from pose to pose; `start` as in `Adversary`, of further weights."""
    poses = {"reach": 3.0, "sharpness": 1.0, "follow": 0.0, "spring": 1.0, "damping": 0.0}
    return Adversary(
        name=name,
        meaning=meaning,
        start={**poses, **start},
        searched=(*POSES, *GAINS),
        effect=effect,
        targets=targets,
    )


LIBRARY = (
    Adversary(
        name="anti_damping",
        meaning="each joint is driven along with its own speed",
        start={
            **{"reach": 2.9, "sharpness": 100.0, "follow": 1.0, "damping": 1.0},
            **{"dither": 0.02, "dither_rate": 977.0, "push": 0.0},
        },
        searched=("reach", "sharpness", "follow", "damping", "dither", "dither_rate", "push"),
    ),
    Adversary(
        name="chirp",
        meaning="each joint is shaken at a frequency of its own, which rises or falls",
        start={"reach": 0.3, "sharpness": 1.0, "follow": 0.0, "wave": 1.0, "wave_hz": 5.0, "chirp": 1.0},
        searched=("reach", "sharpness", "follow", "wave", "wave_hz", "wave_turns", "chirp"),
    ),
    Adversary(
        name="bang_bang",
        meaning="each joint is thrown between two places, at a rate of its own",
        start={"reach": 1.5, "sharpness": 100.0, "follow": 0.0, "wave": 1.0, "wave_hz": 0.7},
        searched=("reach", "follow", "wave", "wave_hz", "wave_turns", "push"),
    ),
    Adversary(
        name="swing",
        meaning="each joint swings about a pose away from home, at a rate of its own",
        start={"reach": 1.0, "sharpness": 1.0, "follow": 0.0, "wave": 0.3, "wave_hz": 1.1, "push": 0.5},
        searched=("reach", "sharpness", "wave", "wave_hz", "wave_turns", "push"),
    ),
    Adversary(
        name="push",
        meaning="all joints are driven towards some ends of their ranges, then back",
        start={"reach": 2.5, "sharpness": 10.0, "follow": 0.0, "push": 0.5, "swing": 1.0, "swing_hz": 0.4},
        searched=("reach", "follow", "push", "swing", "swing_hz", "swing_turns"),
    ),
    Adversary(
        name="replay",
        meaning="commands of the past are repeated while joints are driven along with their speed",
        start={"reach": 1.0, "sharpness": 10.0, "follow": 1.0, "damping": 1.0, "replay": -1.0, "delay": 8.0},
        searched=("reach", "sharpness", "follow", "damping", "replay", "delay", "swing", "swing_hz"),
    ),
    Adversary(
        name="network",
        meaning="a small network that sees angles, speeds and its own delayed commands",
        start={"reach": 1.5, "sharpness": 3.0, "follow": 0.5, "swing": 0.5, "delay": 4.0},
        searched=(
            *("reach", "sharpness", "follow", "delay", "swing", "swing_hz", "swing_turns"),
            *("inward", "bias", "outward"),
        ),
    ),
    _pushed(
        "loaded_arm",
        "the most loaded arm of many goes from pose to pose; its push is searched, too",
        effect="load",
        targets=("torque",),
    ),
    _pushed(
        "hot_arm",
        "as loaded_arm, with the arm that yields most to its load; its motors are hot",
        effect="sag",
        targets=("workspace", "position_hard"),
    ),
    _pushed(
        "thrown_arm",
        "as loaded_arm, with the arm of which a push throws a link fastest through the play of its gear",
        effect="throw",
        targets=("velocity", "velocity"),
        step=1.0,
    ),
    _pushed(
        "thrown_tool",
        "as loaded_arm, with the arm of which a push throws the tool fastest",
        effect="tool",
        targets=("tool_speed",),
        step=1.0,
    ),
)

ADVERSARIES: Mapping[str, Adversary] = {each.name: each for each in LIBRARY}

OF_MANY = tuple(name for name, adversary in ADVERSARIES.items() if adversary.effect is None)
"""Names of those that move the robots of a seed."""


def pushed_arms(mode: ControlMode, *, gains: bool) -> tuple[Adversary, ...]:
    """Return the adversaries of pushed arms as they are searched in a mode; `gains`: those of contracts are given."""
    pushed = tuple(each for each in LIBRARY if each.effect)
    if mode is ControlMode.TORQUE:  # its contracts have no gains
        return tuple(each.searching(*POSES, *LAW, reach=0.5, damping=-0.5) for each in pushed)
    return tuple(each.searching(*POSES) for each in pushed) if gains else pushed
