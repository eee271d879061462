"""Schema of the trend over the soaks of a history in report.json."""

from pydantic import NonNegativeInt

from eval.statistics.numbers import Share
from robots.strict import Many, Strict


class Estimate(Strict):
    """Estimated value with the ends of its confidence interval; None where unknown."""

    value: float | None
    low: float | None
    high: float | None


class RunRow(Strict):
    """One soak.

    Attributes:
        name: its file, or "this soak" for the soak of this report.
        group: index of its `RunGroup`. repeated: True if its draws are among those of another soak of the group.
        rate: hard events per h of operating time, with the 95 % interval where draws may differ.
        goals, availability: shares with 95 % intervals as for `rate`; without a stop, availability has none.
        hottest_c: °C of the hottest winding at any time; `low` is that of the median draw.
    """

    name: str
    started: str
    passed: bool
    group: NonNegativeInt
    repeated: bool
    seed: int
    draws: NonNegativeInt
    running_hours: float
    hard_events: NonNegativeInt
    bad_draws: NonNegativeInt
    rate: Estimate
    goals: Estimate
    availability: Estimate
    hottest_c: Estimate


class RunGroup(Strict):
    """Pooled soaks with the same identity; upper bounds are one-sided, 95 %, rates per h of operating time.

    Attributes:
        changed: keys of the identity that differ from the group before it; empty for the first.
        runs: number of pooled soaks, each with its own draws.
        rate_upper: if draws are alike. draw_rate_upper: if they may differ.
        dispersion_p: how often chance alone spreads the events over the draws at least as unevenly.
        statement: the sentence that the pooled results support. dispersion: whether draws differ, in words.
    """

    policy: str
    policy_digest: str
    code_digest: str
    changed: Many[str]
    runs: NonNegativeInt
    draws: NonNegativeInt
    running_hours: float
    hard_events: NonNegativeInt
    rate_upper: float | None
    draw_rate_upper: float | None
    bad_draws: NonNegativeInt
    bad_draw_upper: Share
    dispersion_p: Share
    statement: str
    dispersion: str


class Trend(Strict):
    """Soaks in the order of time, and their groups in the order of the groups' first soaks."""

    runs: Many[RunRow]
    groups: Many[RunGroup]

    @property
    def last(self) -> RunGroup:
        """Group of the last soak."""
        return self.groups[self.runs[-1].group]
