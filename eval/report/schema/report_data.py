"""Schema of report.json."""

from eval.history.soak_record import SoakRecord
from eval.report.schema.fault_rows import FaultTable
from eval.report.schema.rows import EventRow, Evidence, MonitorRow, RobotRow, Sensitivity
from eval.report.schema.trend_rows import Trend
from eval.statistics.budget import BudgetLine
from eval.statistics.numbers import Count, Number, Share
from robots.strict import Many, Strict


class Exposure(Strict):
    """Simulated time of all robots together; `running_hours`, the operating time, is the exposure of rates.

    `evaluations` is the number of times that every monitor was evaluated: ticks × robots, without diverged simulations.
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
    """True winding temperature of one joint, °C.

    Attributes:
        median_c, hottest_c: of the median robot, and of the hottest robot at each of `Report.sample_h`.
        peak_c: the highest in any tick. hottest_robot: its robot.
        above_soft_h: h above `soft_c` of all robots together, over all ticks.
        longest_h: the most of one robot. longest_robot: that robot.
        folded_back: share of its current that the motor could not draw because of its heat, mean of all samples and
            robots. folded_most: the highest mean of one robot. folded_robot: that robot.
    """

    joint: str
    soft_c: float
    max_c: float
    median_c: Many[Number]
    hottest_c: Many[Number]
    peak_c: Number
    hottest_robot: Count
    above_soft_h: float
    longest_h: float
    longest_robot: Count
    folded_back: Share
    folded_most: Share
    folded_robot: Count


class WornJoint(Strict):
    """A quantity of one joint at start and end: of the median robot, and of the `robot` with the largest change."""

    joint: str
    median: tuple[Number, Number]
    robot: Count
    most_worn: tuple[Number, Number]


class Wear(Strict):
    """A quantity that wears, as absolute value in `unit`, at `Report.sample_h`.

    Attributes:
        median: over all joints of all robots. most_worn: of the joint with the largest change by the end.
        robot, joint: that joint.
        joints: start and end of each joint.
    """

    name: str
    unit: str
    meaning: str
    median: Many[Number]
    most_worn: Many[Number]
    robot: Count
    joint: str
    joints: Many[WornJoint]


class GoalBin(Strict):
    """Goals whose time ended between two times, h; `low` and `high` as in `Goals`."""

    start_h: float
    end_h: float
    attempted: Count
    reached: Count
    low: Share
    high: Share


class CoreGoalCounts(Strict):
    """Goals that a task counts apart, as `Goals`; `meaning` says which, in words."""

    meaning: str
    attempted: Count
    reached: Count
    success: Share
    low: Share
    high: Share


class Goals(Strict):
    """Goals of all robots: `success` is reached ÷ due, `low` and `high` its 95 % interval for independent goals.

    `core` is None for tasks without such goals. `change` is a sentence on the first and the last bin.
    """

    due: Count
    reached: Count
    success: Share
    low: Share
    high: Share
    core: CoreGoalCounts | None = None
    bins: Many[GoalBin]
    change: str


class Stops(Strict):
    """Stops of all robots by reason, of which several may hold at once; a latch is a stop with power loss."""

    total: Count
    latches: Count
    reasons: dict[str, Count]


class Report(SoakRecord):
    """report.json: the record of a soak, and all data of its report.

    `events` are all that were recorded one by one, hard ones first; `MonitorRow.unlisted` counts the others. `trend` is
    None without a history.
    """

    budget: Many[BudgetLine]
    exposure: Exposure
    evidence: Evidence
    goals: Goals
    stops: Stops
    monitors: Many[MonitorRow]
    tail_share: Share
    events: Many[EventRow]
    robots: Many[RobotRow]
    sensitivity: Sensitivity
    sample_h: Many[float]
    heat: Many[Heat]
    wear: Many[Wear]
    faults: FaultTable | None
    trend: Trend | None
    limitations: Many[str]
