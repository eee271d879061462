"""What a soak hands over, and the schema of report.json."""

from collections.abc import Mapping
from dataclasses import dataclass

from eval.history.night_record import Night, Run, Settings
from eval.judge.counts import Counts
from eval.report.schema.fault_rows import FaultTable
from eval.report.schema.numbers import Count, Number, Share
from eval.report.schema.rows import EventRow, Evidence, MonitorRow, RobotRow, Sensitivity
from eval.report.schema.trend_rows import Trend
from robots.arrays import Floats, Ints
from robots.strict import Strict


@dataclass(frozen=True, slots=True, kw_only=True)
class SoakResult:
    """A soak, finished or interrupted, of R robots with n joints.

    Attributes:
        counts: what the judge found.
        sample_h: (T,) h, when `winding_c` and `worn` were taken: at 0, then once a simulated minute or so.
        winding_c: (T, R, n) °C, true winding temperature; NaN once a robot's simulation diverged.
        folded_back: (T, R, n) share of its current that a motor at work could not draw for its heat; NaN as that.
        worn: (T, 4, R, n) what the joints had become: friction as a factor of the new joint's, backlash and encoder
            error in rad, torque constant as a factor; NaN as `winding_c`.
        winding_soft_c, winding_max_c: (n,) °C.
        stops, latches: (T, R) times that a robot had left its work, and lost its power, up to each sample.
        goals_bin_h: h, width of the bins of `goals_attempted` and `goals_reached`, (H,) all robots together.
        parameters: (R,) by name, what each robot was drawn with: see `eval.statistics.sensitivity`.
        bundles: folders of events to see again, as seen from the report's folder.
        unseen: sentences on what the plant does not model.
        faults: on schedule; None if there were none.
    """

    settings: Settings
    run: Run
    counts: Counts
    sample_h: Floats
    winding_c: Floats
    folded_back: Floats
    worn: Floats
    winding_soft_c: Floats
    winding_max_c: Floats
    stops: Ints
    latches: Ints
    goals_bin_h: float
    goals_attempted: Ints
    goals_reached: Ints
    parameters: Mapping[str, Floats]
    bundles: tuple[str, ...]
    unseen: tuple[str, ...]
    faults: FaultTable | None = None


class Line(Strict):
    """One budget line; `about` says what `found` is of, in words.

    `allowed` is the least if `at_least`, else the most; None for no budget.
    """

    name: str
    unit: str
    at_least: bool
    allowed: Number
    found: Number
    passed: bool
    about: str = ""


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


class Heat(Strict):
    """True winding temperature of a joint at `Report.sample_h`, °C: median robot, and hottest each time.

    `peak_c` is the highest on any tick, of `hottest_robot`. `above_soft_h` is h above `soft_c`, all robots together
    and every tick looked at, and `longest_h` the most of one robot, `longest_robot`. `folded_back` is the share of its
    current that the motor could not draw for its heat, mean of all samples and robots, and `folded_most` the highest
    mean of one robot, `folded_robot`.
    """

    joint: str
    soft_c: float
    max_c: float
    median_c: tuple[Number, ...]
    hottest_c: tuple[Number, ...]
    peak_c: Number
    hottest_robot: Count
    above_soft_h: float
    longest_h: float
    longest_robot: Count
    folded_back: Share
    folded_most: Share
    folded_robot: Count


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


class Report(Night):
    """report.json: a night, and all that there is to see of it.

    `events` holds every one that was kept, hard ones first; `MonitorRow.left_out` counts the others. `trend` is None
    without a history.
    """

    budget: tuple[Line, ...]
    exposure: Exposure
    evidence: Evidence
    goals: Goals
    stops: Stops
    monitors: tuple[MonitorRow, ...]
    tail_share: Share
    events: tuple[EventRow, ...]
    robots: tuple[RobotRow, ...]
    sensitivity: Sensitivity
    sample_h: tuple[float, ...]
    heat: tuple[Heat, ...]
    wear: tuple[Wear, ...]
    faults: FaultTable | None
    trend: Trend | None
    unseen: tuple[str, ...]
