"""What the doctor says: one row for each check, and why."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from robots.arrays import Bools, Floats, Ints
from robots.errors import printable

Places = Bools | Ints | slice
NAMED_MAX = 6
"""Joints or numbers that one sentence lists."""


class Verdict(IntEnum):
    """The worst of its notes is that of a row."""

    PASS = 0
    WARN = 1
    FAIL = 2


class Note(NamedTuple):
    """One thing that was seen, in a sentence that says what to do about it."""

    verdict: Verdict
    said: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """A row: what was checked, how it went, and why."""

    check: str
    verdict: Verdict
    said: str


def passed(said: str) -> Note:
    """Nothing to do."""
    return Note(Verdict.PASS, said)


def warned(said: str) -> Note:
    """To be looked at by a person."""
    return Note(Verdict.WARN, said)


def failed(said: str) -> Note:
    """To be mended before anything moves."""
    return Note(Verdict.FAIL, said)


def summed_up(check: str, notes: Iterable[Note]) -> Finding:
    """A row of some notes, the worst first; those that passed are said only where nothing else is."""
    ordered = sorted(notes, key=lambda note: -note.verdict)
    said = [note.said for note in ordered if note.verdict > Verdict.PASS] or [note.said for note in ordered]
    return Finding(check=check, verdict=ordered[0].verdict, said="\n".join(map(printable, said)))


def listed(names: Sequence[str], *numbers: Floats, unit: str = "", which: Places = slice(None)) -> str:
    """Names with their numbers, as in "elbow 1.2 of 3.1, wrist 2 of 3 rad"; only the first where there are many.

    Args:
        names: n of them. numbers: (n,) arrays, each of the first `of` each of the next.
        unit: of all numbers, with its space.
        which: a choice among the n, or their places in another order.
    """
    places = np.arange(len(names))[which]
    said = [f"{names[k]} {' of '.join(f'{of[k]:.3g}' for of in numbers)}" for k in places[:NAMED_MAX]]
    more = f" and {len(places) - NAMED_MAX} more" if len(places) > NAMED_MAX else ""
    return ", ".join(said) + unit + more
