"""Results of checks: messages with a verdict, summarized in one row per check."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import NamedTuple

import numpy as np

from robots.arrays import Bools, Floats, Ints
from robots.errors import printable

Selection = Bools | Ints | slice
NAMED_MAX = 6
"""Joints or numbers listed in one sentence."""


class Verdict(IntEnum):
    """Verdict of a message; the verdict of a row is its worst."""

    PASS = 0
    WARN = 1
    FAIL = 2


class Message(NamedTuple):
    """One observation, with advice."""

    verdict: Verdict
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """A row of the report."""

    check: str
    verdict: Verdict
    text: str


passed, warned, failed = (partial(Message, verdict) for verdict in Verdict)
"""Messages of a passed check, of what a person should look at, and of a defect to fix before anything moves."""


def summarize(check: str, notes: Iterable[Message]) -> CheckResult:
    """Return the row of some messages, worst first; messages that passed only if there are no others."""
    ordered = sorted(notes, key=lambda note: -note.verdict)
    text = [note.text for note in ordered if note.verdict > Verdict.PASS] or [note.text for note in ordered]
    return CheckResult(check=check, verdict=ordered[0].verdict, text="\n".join(map(printable, text)))


def format_values(
    names: Sequence[str], *numbers: Floats, unit: str = "", selection: Selection = slice(None)
) -> str:
    """Return selected names with their numbers, (n,) each: "elbow 1.2 of 3.1, wrist 2 of 3 rad".

    At most `NAMED_MAX` are listed. `unit` has a leading space.
    """
    indices = np.arange(len(names))[selection]
    named = indices[:NAMED_MAX]
    text = [f"{names[k]} {' of '.join(f'{values[k]:.3g}' for values in numbers)}" for k in named]
    more = f" and {len(indices) - NAMED_MAX} more" if len(indices) > NAMED_MAX else ""
    return ", ".join(text) + unit + more


def flag(
    note: Callable[[str], Message],
    selection: Selection,
    before: str,
    names: Sequence[str],
    *numbers: Floats,
    unit: str = "",
    after: str = "",
) -> Iterator[Message]:
    """Yield a message listing the selected names with their numbers between two texts, if any is selected."""
    if len(np.arange(len(names))[selection]):
        yield note(before + format_values(names, *numbers, unit=unit, selection=selection) + after)
