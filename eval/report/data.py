"""What a soak hands over, and the schema of report.json."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from eval.counts import Counts
from robots.strict import Strict

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Count = Annotated[int, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
# None stands for a number that is none: no exposure, a NaN, a diverged simulation.
Number = float | None
Verdict = Literal["passed", "failed", "interrupted"]


def number(value: float, digits: int | None = None) -> Number:
    """A finite number, rounded if `digits` says so; None for any other."""
    return (float(value) if digits is None else round(float(value), digits)) if math.isfinite(value) else None


def series(values: Floats, digits: int) -> tuple[Number, ...]:
    """`number` of each of (T,)."""
    return tuple(number(value, digits) for value in values)


def median(values: Floats) -> Floats:
    """(T, ...) of what is known of the robots of (T, N, ...), NaN for nothing."""
    return np.asarray(np.ma.median(np.ma.masked_invalid(values), axis=1).filled(np.nan))


class Settings(Strict):
    """On what the results depend; `workers` changes only the time it takes.

    Attributes:
        hours: h that each robot was to run.
        policy, policy_digest: the file and its SHA-256. robot, robot_digest: the name and its SHA-256.
        draws_digest: SHA-256 of the distributions that robots were drawn from. code_digest: of what ran.
        budget: the file. versions: of Python and of the libraries, by name.
    """

    command: str
    robot: str
    robot_digest: str
    draws_digest: str
    policy: str
    policy_digest: str
    code_digest: str
    budget: str
    seed: int
    hours: float
    robots: int
    shard_width: int
    workers: int
    versions: dict[str, str]


class Run(Strict):
    """How it went this time.

    Attributes:
        started: ISO 8601 with zone. wall_s: s of real time since then.
        hours: h that each robot did run, on average; robots that never began count as 0.
        resumed_hours: h of these that an earlier start had left behind.
    """

    started: str
    wall_s: float
    hours: float
    resumed_hours: float
    interrupted: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class SoakResult:
    """A soak, finished or interrupted, of R robots with n joints.

    Attributes:
        counts: what the judge found.
        sample_h: (T,) h, when `winding_c` and `worn` were taken: at 0, then once a simulated minute or so.
        winding_c: (T, R, n) °C, true winding temperature; NaN once a robot's simulation diverged.
        worn: (T, 4, R, n) what the joints had become: friction as a factor of the new joint's, backlash and encoder
            error in rad, torque constant as a factor; NaN as `winding_c`.
        winding_soft_c, winding_max_c: (n,) °C.
        goals_bin_h: h, width of the bins of `goals_attempted` and `goals_reached`, (H,) all robots together.
        unseen: sentences on what the plant does not model.
    """

    settings: Settings
    run: Run
    counts: Counts
    sample_h: Floats
    winding_c: Floats
    worn: Floats
    winding_soft_c: Floats
    winding_max_c: Floats
    goals_bin_h: float
    goals_attempted: Ints
    goals_reached: Ints
    unseen: tuple[str, ...]


class Line(Strict):
    """One budget line; `allowed` is the least if `at_least`, else the most."""

    name: str
    unit: str
    at_least: bool
    allowed: float
    found: Number
    passed: bool


class Exposure(Strict):
    """How much was seen: h of all robots together; `running` is the exposure of rates.

    `evaluations` is how often every monitor was asked: ticks × robots, less those of diverged simulations.
    """

    draws: Count
    ticks: Count
    invalid_ticks: Count
    evaluations: Count
    hours: float
    running_hours: float
    moving_hours: float
    availability: Share


class Evidence(Strict):
    """Hard events of all monitors together; upper bounds one-sided at `confidence`, rates per hour."""

    confidence: Share
    hard_events: Count
    hard_rate: Number
    hard_rate_upper: Number
    bad_draws: Count
    bad_draw_upper: Share


class Channel(Strict):
    """A monitor on one joint, None for the whole robot; `worst` is a share of `limit`."""

    joint: str | None
    limit: float
    events: Count
    bad_ticks: Count
    worst: Number


class MonitorRow(Strict):
    """A monitor over all robots; `rate_upper` per hour under way, on its own."""

    name: str
    unit: str
    hard: bool
    meaning: str
    evaluations: Count
    events: Count
    bad_draws: Count
    rate_upper: Number
    channels: tuple[Channel, ...]


class EventRow(Strict):
    """An event: `start_h` h into the run, `length_s` s long, `worst` as a share of the limit."""

    robot: Count
    monitor: str
    joint: str | None
    hard: bool
    start_h: float
    length_s: float
    worst: Number


class Heat(Strict):
    """True winding temperature of a joint at `Report.sample_h`, °C: median robot, and hottest each time."""

    joint: str
    soft_c: float
    max_c: float
    median_c: tuple[Number, ...]
    hottest_c: tuple[Number, ...]


class WornJoint(Strict):
    """A quantity of one joint at the start and at the end: median robot, and the `robot` that moved furthest."""

    joint: str
    median: tuple[Number, Number]
    robot: Count
    most_worn: tuple[Number, Number]


class Wear(Strict):
    """A quantity that wears, by size, in `unit`, at `Report.sample_h`: median of all joints of all robots, and one.

    Attributes:
        meaning: for the reader. median, most_worn: curves; the latter of the joint that moved furthest by the end:
        robot, joint: which one that is.
        joints: one by one.
    """

    name: str
    unit: str
    meaning: str
    median: tuple[Number, ...]
    most_worn: tuple[Number, ...]
    robot: Count
    joint: str
    joints: tuple[WornJoint, ...]


class GoalBin(Strict):
    """Goals whose time was over between two times, h; `low` and `high` as in `Goals`."""

    start_h: float
    end_h: float
    attempted: Count
    reached: Count
    low: Share
    high: Share


class Goals(Strict):
    """The work: `success` is reached ÷ due, `low` and `high` its 95 % interval if goals were independent.

    `change` is a sentence on the first and the last bin.
    """

    due: Count
    reached: Count
    success: Share
    low: Share
    high: Share
    bins: tuple[GoalBin, ...]
    change: str


class Stops(Strict):
    """Times that robots left their work, and why; several reasons may hold at once. After a latch they lost power."""

    total: Count
    latches: Count
    reasons: dict[str, Count]


class Report(Strict):
    """report.json. `events` holds the first of each channel, hard ones first."""

    format: Literal[1]
    verdict: Verdict
    statement: str
    settings: Settings
    run: Run
    budget: tuple[Line, ...]
    exposure: Exposure
    evidence: Evidence
    goals: Goals
    stops: Stops
    monitors: tuple[MonitorRow, ...]
    events: tuple[EventRow, ...]
    sample_h: tuple[float, ...]
    heat: tuple[Heat, ...]
    wear: tuple[Wear, ...]
    unseen: tuple[str, ...]
