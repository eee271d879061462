"""Schema of evidence, monitors, events, robots and sensitivity in report.json."""

from eval.statistics.numbers import Count, Number, Share
from eval.statistics.sensitivity import Cause
from robots.strict import Many, Strict


class FurtherHours(Strict):
    """Further operating hours of all robots together that show a mean time between hard events of `mtbf_h` h.

    `hours` without another event, `same_rate_hours` if as many events occur again; the same rate in all hours.
    """

    mtbf_h: float
    hours: float
    same_rate_hours: float


class Evidence(Strict):
    """Hard events of all monitors together with confidence bounds; rates per hour of operating time.

    Attributes:
        confidence: of each upper bound, one-sided, and of each interval, two-sided.
        hard_rate_upper, hard_rate_interval: of the rate if it is the same in all hours and draws.
        draw_rate_upper, draw_rate_interval: of the rate over draws that may differ; valid in both cases.
        bad_draws: draws with a hard event or a diverged simulation. bad_draw_upper: bound of their share.
        dispersion_p: how often chance alone spreads the events over the draws at least as unevenly.
        dispersion: the same in words.
        family: number of hard monitors with limits. family_confidence: confidence of the bound of each, for all to hold
            at once.
        further: operating time needed to show a mean time between events.
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
    further: Many[FurtherHours]


class Channel(Strict):
    """One monitor on one joint; joint None for a monitor of the whole robot.

    Attributes:
        limit: in the monitor's unit; None for no known limit, so that nothing was judged.
        worst: the highest load of all ticks, as a share of `limit`; the least margin is 1 - `worst`.
        tail: the load that all ticks but a share of `Report.tail_share` stayed below, as a share of `limit`, rounded up
            to 0.01 but not above `worst`; equal to `worst` from 2 on.
    """

    joint: str | None
    limit: Number
    events: Count
    bad_ticks: Count
    worst: Number
    tail: Number


class MonitorRow(Strict):
    """One monitor over all robots; rates per hour of operating time.

    Attributes:
        unlisted: number of events that were counted but are not listed one by one.
        rate_upper, rate_interval: for this monitor alone, if all hours have the same rate, at `Evidence.confidence`.
        draw_rate_upper: as `rate_upper`, if draws may differ.
        family_rate_upper: as `draw_rate_upper` at `Evidence.family_confidence`, so that the bounds of all hard monitors
            hold at once; None for a soft one.
        load_histogram: ticks of all robots and joints by load as a share of the limit, in bins of 0.01; the last bin
            holds all loads from 2 on. Empty if unknown.
    """

    name: str
    unit: str
    hard: bool
    meaning: str
    evaluations: Count
    events: Count
    unlisted: Count
    bad_draws: Count
    rate_upper: Number
    rate_interval: tuple[Number, Number]
    draw_rate_upper: Number
    family_rate_upper: Number
    channels: Many[Channel]
    load_histogram: Many[Count]


class EventRow(Strict):
    """One event.

    Attributes:
        start_h: h since the start of the soak. length_s: s.
        worst: the highest load, as a share of the limit. margin: what was left to the limit, in the monitor's `unit`;
            negative.
        bundle: folder for soak-replay, relative to the report; None for most events.
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
        hours: h simulated. judged_hours: h before its simulation diverged, if it did. running_hours: h in operation.
        stopped_h, latched_h: times, h, of samples (about every minute) with a new stop, or a new power loss.
        unlisted_h: h from which on some of its events are counted but not listed; None if all are listed.
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
    stopped_h: Many[float]
    latched_h: Many[float]
    unlisted_h: Number


class Sensitivity(Strict):
    """Correlation of the drawn robot parameters with failures; see `eval.statistics.sensitivity`.

    Attributes:
        draws: number of draws that operated and had goals due. parameters: number tested. outcomes: tested, those
            that differ between draws.
        noticeable: the least significant correlation; None if none can be significant.
        causes: the strongest correlations, significant or not. statement: the conclusion.
    """

    draws: Count
    parameters: Count
    outcomes: Many[str]
    noticeable: Share | None
    causes: Many[Cause]
    statement: str
