"""All mutants, all guards off at once on robots with doubled variation, and an idle policy."""

from collections.abc import Iterator
from typing import NamedTuple

from deploy.reasons import Reason
from eval.judge.counts import Counts
from eval.judge.monitors import NAMES
from eval.mutants.attacks import cycle_poses, encoder_offset_at_start, hot_motors_at_start, nan_after
from eval.mutants.command_guards import FAR, SAFETY, SENT
from eval.mutants.estimation_guards import ESTIMATION
from eval.mutants.guard_removal import (
    ignore_non_finite_action,
    ignore_reasons,
    in_sequence,
    remove_foldback,
    remove_heat_margin,
    scale_planner_limits,
    trust_first_sample,
    widen_target_range,
)
from eval.mutants.heat_guards import HEAT_GUARDS
from eval.mutants.mode_guards import TORQUE_MODE, VELOCITY_MODE
from eval.mutants.situation import INVALID, LATCHES, Mutant, Situation, run_situation
from eval.statistics.budget import check, load_budget
from robots.spec import RobotSpec

MUTANTS = SAFETY + SENT + ESTIMATION + HEAT_GUARDS + VELOCITY_MODE + TORQUE_MODE

UNGUARDED = in_sequence(
    scale_planner_limits(qd_max=1.5, qdd_max=2.0, qddd_max=2.0),
    widen_target_range,
    remove_heat_margin,
    remove_foldback,
    trust_first_sample,
    ignore_non_finite_action,
    ignore_reasons(~Reason.NONE),
)
"""All guards off: no stop reasons, no planner limits, no current foldback, no heat margin, no filter confirmation, and
non-finite actions are ignored."""
ALL_GUARDS_OFF = (
    Situation(
        description="an arm with windings at 106 °C moves violently",
        policy=cycle_poses(
            0.7,
            FAR | {"shoulder_pan": -1.2},
            FAR | {"shoulder_pan": 1.2, "wrist_3": 3.4},
            {"shoulder_lift": -0.2, "elbow": 1.6, "wrist_1": 0.6, "wrist_3": -3.4},
            {"shoulder_lift": -2.2, "elbow": 0.2},
        ),
        disturbance=hot_motors_at_start(90.0, 16.0),
        spread=2.0,
        seconds=4.0,
    ),
    Situation(
        description="armed at once, first packets off by 0.6 rad, and soon NaN actions",
        policy=nan_after(0.1),
        disturbance=encoder_offset_at_start(5, 0.6),
        spread=2.0,
        arm_at_once=True,
        seconds=0.2,
    ),
)
"""Robots with doubled variation of their parameters."""
IDLE = Situation(description="idle policy", policy=lambda runtime: 0.0 * runtime.action.last, seconds=13.0)


class Row(NamedTuple):
    """Result of a mutant.

    Attributes:
        with_guard, without_guard: events of the mutant's monitor; None if there is no such monitor.
    """

    mutant: Mutant
    with_guard: int | None
    without_guard: int | None

    @property
    def caught(self) -> bool:
        """True if the monitor has events only without the guard."""
        return self.with_guard == 0 and bool(self.without_guard)


def event_count(counts: Counts, monitor: str) -> int | None:
    """Return the number of events of a monitor; None if the judge has no such monitor."""
    if monitor in (LATCHES, INVALID):
        return int(getattr(counts, monitor).sum())
    return counts.total(monitor) if monitor in NAMES else None


def run_mutants(spec: RobotSpec, mutants: tuple[Mutant, ...] = MUTANTS) -> Iterator[Row]:
    """Yield the result of each mutant; a shared situation is run with all guards only once."""
    guarded: dict[int, Counts] = {}
    for mutant in mutants:
        situation, key = mutant.situation, id(mutant.situation)
        if key not in guarded:
            guarded[key] = run_situation(spec, situation)
        unguarded = run_situation(spec, situation, mutant.remove_guard)
        events = (event_count(counts, mutant.monitor) for counts in (guarded[key], unguarded))
        yield Row(mutant, *events)


def silent_monitors(spec: RobotSpec) -> list[str]:
    """Return monitors without events although all guards are off and variation is doubled; expected none."""
    counts = [run_situation(spec, situation, UNGUARDED) for situation in ALL_GUARDS_OFF]
    return [m.name for m in counts[0].monitors if not any(each.total(m.name) for each in counts)]


def idle_budget_failures(spec: RobotSpec) -> list[str]:
    """Return lines of the shipped budget that an idle policy exceeds."""
    return [line.name for line in check(load_budget(), run_situation(spec, IDLE)) if not line.passed]
