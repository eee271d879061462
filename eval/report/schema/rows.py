"""The schema of what report.json says of evidence, monitors, events, draws and causes."""

from typing import Annotated

from pydantic import Field

from eval.report.schema.numbers import Count, Number, Share
from robots.strict import Strict


class Further(Strict):
    """Hours of all robots together, still to run until a mean time between hard events of `mtbf_h` h is shown.

    `hours` if no other event comes, `alike_hours` if as many come as came so far; all hours taken as alike.
    """

    mtbf_h: float
    hours: float
    alike_hours: float


class Evidence(Strict):
    """Hard events of all monitors together, and how sure the counts allow us to be; rates per hour under way.

    Attributes:
        confidence: of each upper bound, one-sided, and of each interval, two-sided.
        hard_rate_upper, hard_rate_interval: of the rate if all hours are alike, whatever the draw.
        draw_rate_upper, draw_rate_interval: of the rate over draws that may differ; they hold either way.
        bad_draws: with a hard event or a simulation that diverged. bad_draw_upper: of their share among all draws.
        dispersion_p: how often chance alone spreads as many events over the draws as unevenly. dispersion: in words.
        family: hard monitors that were judged. family_confidence: of each one's bound, for all to hold at once.
        further: what it takes to show a mean time between events.
    """

    confidence: Share
    hard_events: Count
    hard_rate: Number
    hard_rate_upper: Number
    hard_rate_interval: tuple[Number, Number]
    draw_rate_upper: Number
    draw_rate_interval: tuple[Number, Number]
    bad_draws: Count
    bad_draw_upper: Share
    dispersion_p: Share
    dispersion: str
    family: Count
    family_confidence: Share
    further: tuple[Further, ...]


class Channel(Strict):
    """A monitor on one joint, None for the whole robot.

    Attributes:
        limit: in the monitor's unit; None where nothing says it, and nothing was judged.
        worst: the highest of all ticks, as a share of `limit`: the least margin is 1 less that.
        tail: what all but `Report.tail_share` of the ticks stayed below, as a share of `limit`, rounded up to 0.01
            but for no more than `worst`, which it is from 2 on.
    """

    joint: str | None
    limit: Number
    events: Count
    bad_ticks: Count
    worst: Number
    tail: Number


class MonitorRow(Strict):
    """A monitor over all robots; rates per hour under way.

    Attributes:
        left_out: how many of its events were counted and not kept one by one.
        rate_upper, rate_interval: on its own, if all hours are alike, at `Evidence.confidence`.
        draw_rate_upper: the same if draws may differ. family_rate_upper: the same at `Evidence.family_confidence`,
            so that those of all hard monitors hold at once; None for a soft one.
        loads: ticks of all robots and joints by their share of the limit, in bins of 0.01 of which the last holds all
            from 2 on; empty where it is not known.
    """

    name: str
    unit: str
    hard: bool
    meaning: str
    evaluations: Count
    events: Count
    left_out: Count
    bad_draws: Count
    rate_upper: Number
    rate_interval: tuple[Number, Number]
    draw_rate_upper: Number
    family_rate_upper: Number
    channels: tuple[Channel, ...]
    loads: tuple[Count, ...]


class EventRow(Strict):
    """An event: `start_h` h into the run, `length_s` s long.

    `worst` is a share of the limit, and `margin` what was left to it, in the monitor's `unit`: negative. `bundle` is
    the folder to see it again from, beside the report, for soak-replay; None for most.
    """

    robot: Count
    monitor: str
    joint: str | None
    hard: bool
    start_h: float
    length_s: float
    worst: Number
    margin: Number
    unit: str
    bundle: str | None


class RobotRow(Strict):
    """One draw, by its number in the soak.

    Attributes:
        hours: h lived. judged_hours: h before its simulation diverged, if it did. running_hours: h under way.
        stopped_h, latched_h: h by which it had newly left its work, or lost its power: samples of a minute or so.
        unlisted_h: h from which on some of its events were counted and are not listed; None if all are.
    """

    robot: Count
    hours: float
    judged_hours: float
    running_hours: float
    goals_due: Count
    goals_reached: Count
    stops: Count
    latches: Count
    hard_events: Count
    soft_events: Count
    stopped_h: tuple[float, ...]
    latched_h: tuple[float, ...]
    unlisted_h: Number


class Cause(Strict):
    """Spearman's rank correlation `rho` of a parameter with an outcome over the draws; `p` of all pairs together."""

    parameter: str
    outcome: str
    rho: Annotated[float, Field(ge=-1, le=1)]
    p: Share


class Sensitivity(Strict):
    """Which of the numbers that robots are drawn with explain what went wrong; see `eval.statistics.sensitivity`.

    Attributes:
        draws: that were under way and had goals due. parameters: looked at. outcomes: looked at, that differ.
        noticeable: the least correlation that stands out of chance; None if none can.
        causes: the strongest pairs, whether they stand out or not. said: what they show, in words.
    """

    draws: Count
    parameters: Count
    outcomes: tuple[str, ...]
    noticeable: Share | None
    causes: tuple[Cause, ...]
    said: str
