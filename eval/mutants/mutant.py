"""A mutant: one guard removed, a situation in which it matters, and the monitor that must report it."""

from dataclasses import dataclass

from deploy.state import Reason
from eval.judge.counts import Counts
from eval.judge.monitors import NAMES
from eval.mutants.guard_removal import GuardRemoval, ignore_reasons
from eval.mutants.situation import Situation

LATCHES, INVALID = "latches", "invalid"
"""Counts of the judge besides its monitors."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """A removed guard and the event that must follow.

    Attributes:
        guard: description of the guard and its removal.
        remove_guard: function that removes it from a runtime.
        situation: run with the guard and without.
        monitor: name of the judge's monitor: no events with the guard, at least one without.
        reasons: stop reasons that are no longer raised.
    """

    guard: str
    remove_guard: GuardRemoval
    situation: Situation
    monitor: str
    reasons: Reason = Reason.NONE


def check_off(guard: str, reason: Reason, monitor: str, situation: Situation) -> Mutant:
    """Return the mutant without one check: its stop reason is never raised."""
    remove_guard = ignore_reasons(reason)
    return Mutant(
        guard=f"{guard}, off", remove_guard=remove_guard, situation=situation, monitor=monitor, reasons=reason
    )


def event_count(counts: Counts, monitor: str) -> int | None:
    """Return the number of events of a monitor; None if the judge has no such monitor."""
    if monitor in (LATCHES, INVALID):
        return int(getattr(counts, monitor).sum())
    return counts.total(monitor) if monitor in NAMES else None
