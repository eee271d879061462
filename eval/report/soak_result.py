"""Input of the report: settings, counts and samples of one soak."""

from collections.abc import Mapping
from dataclasses import dataclass

from eval.history.soak_record import Run, Settings
from eval.judge.counts import Counts
from eval.report.schema.fault_rows import FaultTable
from robots.arrays import Floats, Ints


@dataclass(frozen=True, slots=True, kw_only=True)
class SoakResult:
    """Results of a finished or interrupted soak of R robots with n joints.

    Attributes:
        counts: from the judge.
        sample_h: (T,) h, times of the samples: 0, then about every simulated minute.
        winding_c: (T, R, n) °C, true winding temperature; NaN once a robot's simulation diverged.
        folded_back: (T, R, n) share of its current that a working motor could not draw because of its heat; NaN as
            above.
        worn: (T, 4, R, n) wear of the joints: friction relative to the new joint, backlash and encoder error in rad,
            torque constant relative to the new motor; NaN as `winding_c`.
        stops, latches: (T, R) stops, and power losses, up to each sample.
        goals_bin_h: h, width of the bins of `goals_attempted` and `goals_reached`, (H,) of all robots together.
        parameters: (R,) by name, drawn parameters of each robot: see `eval.statistics.sensitivity`.
        bundles: folders of events for soak-replay, relative to the report's.
        faults: responses to injected faults; None without fault injection.
    """

    settings: Settings
    run: Run
    counts: Counts
    sample_h: Floats
    winding_c: Floats
    folded_back: Floats
    worn: Floats
    stops: Ints
    latches: Ints
    goals_bin_h: float
    goals_attempted: Ints
    goals_reached: Ints
    parameters: Mapping[str, Floats]
    bundles: tuple[str, ...]
    faults: FaultTable | None = None
