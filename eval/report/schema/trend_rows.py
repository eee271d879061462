"""The schema of what report.json says of tonight among the nights of a history."""

from pydantic import NonNegativeInt

from eval.report.schema.numbers import Share
from robots.strict import Strict


class Span(Strict):
    """A number and the two between which it may lie; None for what is not known."""

    value: float | None
    low: float | None
    high: float | None


class NightRow(Strict):
    """A night.

    Attributes:
        name: its file, or that it is the one of this report.
        group: the `Group` it belongs to, from 0 on. again: its draws are among those of a night that counts.
        rate: hard events per h under way, and its 95 % interval if draws may differ.
        goals, availability: shares, and as `rate`; without a stop, availability has no interval.
        hottest_c: °C of the hottest winding at any time; `low` is that of the median draw.
    """

    name: str
    started: str
    passed: bool
    group: NonNegativeInt
    again: bool
    seed: int
    draws: NonNegativeInt
    running_hours: float
    hard_events: NonNegativeInt
    bad_draws: NonNegativeInt
    rate: Span
    goals: Span
    availability: Span
    hottest_c: Span


class Group(Strict):
    """Nights of one identity, put together; upper bounds are one-sided, 95 %, rates per h under way.

    Attributes:
        changed: in what it differs from the group before it; empty for the first.
        nights: that were put together, each with draws of its own.
        rate_upper: if draws are alike. draw_rate_upper: if they may differ.
        dispersion_p: how often chance alone spreads events over draws so unevenly.
        statement: the sentence that these nights support. differ: another, on whether draws differ.
    """

    policy: str
    policy_digest: str
    code_digest: str
    changed: tuple[str, ...]
    nights: NonNegativeInt
    draws: NonNegativeInt
    running_hours: float
    hard_events: NonNegativeInt
    rate_upper: float | None
    draw_rate_upper: float | None
    bad_draws: NonNegativeInt
    bad_draw_upper: Share
    dispersion_p: Share
    statement: str
    differ: str


class Trend(Strict):
    """Nights in the order of time, and their groups in the order of first nights."""

    nights: tuple[NightRow, ...]
    groups: tuple[Group, ...]

    @property
    def last(self) -> Group:
        """What the last night belongs to."""
        return self.groups[self.nights[-1].group]
