"""Fault classes that consist of others: one cause with several effects, and two independent faults of one robot."""

from dataclasses import dataclass

import numpy as np

from eval.faults.fault_class import ROBOT, FaultClass, Part

ANSWER_S = 0.05, 0.4
"""s in which most robots answer a fault: from its detection to their rest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CombinedFault(FaultClass):
    """One cause with several effects, all at once; those of a joint at the same joint.

    Attributes:
        effects: each for as long as it lasts.
    """

    effects: tuple[FaultClass, ...]

    def parts(self, channel: int | None, rng: np.random.Generator) -> tuple[Part, ...]:
        """Return the effects, at their common channel."""
        return tuple(Part(effect, channel, 0.0) for effect in self.effects)


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultPair(FaultClass):
    """Two different faults, drawn at random from others.

    Attributes:
        component: as in `FaultClass`.
        classes: those others.
        delay_s: s, least and largest delay of the second fault.
    """

    component: str = ROBOT
    classes: tuple[FaultClass, ...]
    delay_s: tuple[float, float]

    def parts(self, channel: int | None, rng: np.random.Generator) -> tuple[Part, ...]:
        """Draw two classes, a channel of each, and the delay of the second."""
        first, second = (self.classes[k] for k in rng.choice(len(self.classes), 2, replace=False))
        delay_s = float(rng.uniform(*self.delay_s))
        return Part(first, _channel(first, rng), 0.0), Part(second, _channel(second, rng), delay_s)


def _channel(fault: FaultClass, rng: np.random.Generator) -> int | None:
    return fault.channels[int(rng.integers(len(fault.channels)))]


def pairs(classes: tuple[FaultClass, ...]) -> tuple[FaultPair, FaultPair]:
    """Return the pairs that are drawn from other classes: at once, and the second while a robot answers the first."""
    lasts_s = max(each.lasts_s for each in classes)
    return (
        FaultPair(
            failure_mode="two faults",
            lasts_s=lasts_s,
            meaning="two of the other faults, drawn at random, at once",
            classes=classes,
            delay_s=(0.0, 0.0),
        ),
        FaultPair(
            failure_mode="fault during answer",
            lasts_s=lasts_s + ANSWER_S[1],
            meaning="one of the other faults, and a second one 0.05 to 0.4 s later",
            classes=classes,
            delay_s=ANSWER_S,
        ),
    )
