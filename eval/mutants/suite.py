"""Every guard taken away in its turn; and all of them at once, on robots drawn twice as far out."""

from collections.abc import Iterator
from dataclasses import dataclass

from deploy.state import Reason
from eval.judge.counts import Counts
from eval.mutants.command_guards import FAR, SAFETY, SENT
from eval.mutants.disturbances import encoder_offset_at_start, hot_motors_at_start
from eval.mutants.estimation_guards import ESTIMATION
from eval.mutants.guard_removal import (
    ignore_non_finite_action,
    ignore_reasons,
    remove_all,
    remove_foldback,
    remove_heat_margin,
    scale_planner_limits,
    trust_first_sample,
    widen_target_range,
)
from eval.mutants.heat_guards import HEAT_GUARDS
from eval.mutants.hostile_policies import cycle_poses, nan_after
from eval.mutants.mutant import Mutant, heard
from eval.mutants.situation import Situation, live
from eval.statistics.budget import check, load_budget
from robots.spec import RobotSpec

MUTANTS = SAFETY + SENT + ESTIMATION + HEAT_GUARDS

EVERYTHING = ~Reason.NONE
UNGUARDED = remove_all(
    scale_planner_limits(qd_max=1.3, qdd_max=2.0, qddd_max=2.0),
    widen_target_range,
    remove_heat_margin,
    remove_foldback,
    trust_first_sample,
    ignore_non_finite_action,
    ignore_reasons(EVERYTHING),
)
"""Safety and estimator find nothing, the planner keeps no limit, no motor is folded back, and nobody waits for a
filter to be sure or minds what the policy says."""
FURY = (
    Situation(
        words="an arm whose windings have 106 °C is thrown about",
        says=cycle_poses(
            0.7,
            FAR | {"shoulder_pan": -1.2},
            FAR | {"shoulder_pan": 1.2, "wrist_3": 3.4},
            {"shoulder_lift": -0.2, "elbow": 1.6, "wrist_1": 0.6, "wrist_3": -3.4},
            {"shoulder_lift": -2.2, "elbow": 0.2},
        ),
        befalls=hot_motors_at_start(90.0, 16.0),
        spread=2.0,
        seconds=4.0,
    ),
    Situation(
        words="armed at once, on first packets that are off by 0.6 rad, and soon the policy says NaN",
        says=nan_after(0.1),
        befalls=encoder_offset_at_start(5, 0.6),
        spread=2.0,
        arm_s=0.005,
        seconds=0.2,
    ),
)
"""Robots drawn twice as far out."""
IDLE = Situation(
    words="a policy that asks for nothing", says=lambda runtime: 0.0 * runtime.action.last, seconds=13.0
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What the judge said of a mutant.

    Attributes:
        whole, weakened: events of the mutant's monitor with the guard and without; None where there is no such monitor.
    """

    mutant: Mutant
    whole: int | None
    weakened: int | None

    @property
    def caught(self) -> bool:
        """Whether the monitor is silent with the guard and heard without."""
        return self.whole == 0 and bool(self.weakened)


def rows(spec: RobotSpec, mutants: tuple[Mutant, ...] = MUTANTS) -> Iterator[Row]:
    """Live through every mutant; a situation that several share is lived through once with all guards."""
    lived: dict[int, Counts] = {}
    for mutant in mutants:
        place = id(mutant.situation)
        if place not in lived:
            lived[place] = live(spec, mutant.situation)
        yield Row(
            mutant=mutant,
            whole=heard(lived[place], mutant.monitor),
            weakened=heard(live(spec, mutant.situation, mutant.weaken), mutant.monitor),
        )


def silent(spec: RobotSpec) -> list[str]:
    """Monitors that say nothing though no guard is left and draws are doubled: none, or the plant is too kind."""
    counts = [live(spec, situation, UNGUARDED) for situation in FURY]
    return [m.name for m in counts[0].monitors if not any(each.total(m.name) for each in counts)]


def idle_fails(spec: RobotSpec) -> list[str]:
    """Lines of the shipped budget that a policy which asks for nothing exceeds."""
    return [line.name for line in check(load_budget(), live(spec, IDLE)) if not line.passed]
