"""Schema of injected faults in report.json."""

from pydantic import NonNegativeInt

from eval.statistics.numbers import Share
from robots.strict import Many, Strict


class Times(Strict):
    """Times since the injection, s, of the injections where it happened."""

    count: NonNegativeInt
    median_s: float
    worst_s: float


class FaultRow(Strict):
    """One class of faults.

    Attributes:
        where, what, meaning: as in the catalogue. required: the most severe correct answer.
        injections: those that count. not_running: those into robots that were not in operation, which do not count.
        handled: those without a hard event and with a correct answer. handled_lower: lower bound of their share, 95 %,
            one-sided.
        answers: number of injections by answer. violations: number of injections by hard monitor with an event.
        stopped, at_rest: times until the robot stopped operating, and until it truly stood still; None if none did.
        resumed: number of injections after which the robot operated again before its next fault.
        deviation_rad: largest deviation of a true angle from the angle sent, until the robot stood still; None if not
            finite.
        load: largest share of the limits of angle and speed.
    """

    where: str
    what: str
    meaning: str
    required: str
    injections: NonNegativeInt
    not_running: NonNegativeInt
    handled: NonNegativeInt
    handled_lower: Share
    answers: dict[str, NonNegativeInt]
    violations: dict[str, NonNegativeInt]
    stopped: Times | None
    at_rest: Times | None
    resumed: NonNegativeInt
    deviation_rad: float | None
    load: float | None


class UnhandledFault(Strict):
    """A fault that was not handled: `start_h` h since the start of the soak; times in s since then, None for never."""

    robot: NonNegativeInt
    fault: str
    channel: str | None
    start_h: float
    answer: str
    violations: Many[str]
    stopped_s: float | None
    at_rest_s: float | None
    deviation_rad: float | None


class FaultTable(Strict):
    """Injected faults by class.

    Attributes:
        coverage: share of each class that must be shown to be handled.
        injections: number of injections that were followed to their end. unhandled: the first unhandled ones.
        not_injected: faults that the simulation cannot inject, and why.
    """

    coverage: Share
    injections: NonNegativeInt
    rows: Many[FaultRow]
    unhandled: Many[UnhandledFault]
    not_injected: Many[str]
