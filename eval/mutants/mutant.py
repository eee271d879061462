"""One guard taken away, the situation in which that matters, and the judge's monitor that must say so."""

from dataclasses import dataclass

from deploy.state import Reason
from eval.judge.counts import Counts
from eval.judge.monitors import NAMES
from eval.mutants.guard_removal import Weaken
from eval.mutants.situation import Situation

LATCHES, INVALID = "latches", "invalid"
"""What the judge counts beside its monitors, and a budget limits as it limits them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """A guard and what becomes of a robot without it.

    Attributes:
        guard: what is weakened, and how, in words.
        weaken: does it to a runtime.
        situation: lived through with the guard and without.
        monitor: of the judge: silent with the guard, heard without.
        reasons: those that nobody raises any more.
    """

    guard: str
    weaken: Weaken
    situation: Situation
    monitor: str
    reasons: Reason = Reason.NONE


def heard(counts: Counts, monitor: str) -> int | None:
    """How often the judge said so; None where it has no such monitor."""
    if monitor in (LATCHES, INVALID):
        return int(getattr(counts, monitor).sum())
    return counts.total(monitor) if monitor in NAMES else None
