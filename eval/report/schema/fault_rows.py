"""The schema of what report.json says of faults on schedule."""

from typing import Annotated

from pydantic import Field, NonNegativeInt

from robots.strict import Strict

Share = Annotated[float, Field(ge=0, le=1)]


class Times(Strict):
    """s since the injection, over those robots that did it."""

    many: NonNegativeInt
    median_s: float
    worst_s: float


class FaultRow(Strict):
    """One class of faults.

    Attributes:
        where, what, meaning: as in the catalogue. asked: the most severe answer that is right.
        injections: those that count; not_at_work: those that found no robot at work, and do not.
        handled: with no hard event and an answer that is right; handled_lower: bound of its share, 95 %, one-sided.
        answers: how often each was given. hurt: hard monitors that had something to say, by how many faults.
        left, rest: when a robot left its work, and when it then truly stood still; None if none did.
        again: how many were at work again before the next fault.
        astray_rad: worst distance of a true angle from the one sent, until the robot stood; None for no number.
        load: worst share of the limits of angle and speed.
    """

    where: str
    what: str
    meaning: str
    asked: str
    injections: NonNegativeInt
    not_at_work: NonNegativeInt
    handled: NonNegativeInt
    handled_lower: Share
    answers: dict[str, NonNegativeInt]
    hurt: dict[str, NonNegativeInt]
    left: Times | None
    rest: Times | None
    again: NonNegativeInt
    astray_rad: float | None
    load: float | None


class Miss(Strict):
    """A fault that was not handled: `start_h` h into the run; times in s since then, None for never."""

    robot: NonNegativeInt
    fault: str
    channel: str | None
    start_h: float
    answer: str
    hurt: tuple[str, ...]
    left_s: float | None
    rest_s: float | None
    astray_rad: float | None


class FaultTable(Strict):
    """Faults on schedule; `coverage` is the share of each class that must be shown to be handled.

    `injections` are all those whose story is over; `misses` the first of those that were not handled.
    """

    coverage: Share
    injections: NonNegativeInt
    rows: tuple[FaultRow, ...]
    misses: tuple[Miss, ...]
    not_injected: tuple[str, ...]
