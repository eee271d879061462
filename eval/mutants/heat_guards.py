"""Mutants of guards of the windings: heat check, heat observer, foldback, supervisor."""

from dataclasses import replace

from deploy.backends.sim.sensor_faults import Failure
from deploy.reasons import Reason
from eval.mutants.attacks import cycle_poses, hot_motors_at_start, move_to, sensor_faults
from eval.mutants.command_guards import FAR, LIGHT
from eval.mutants.guard_removal import (
    accept_stuck_currents,
    check_with_all_current,
    downgrade_to_category_2,
    freeze_lost_currents,
    ignore_reasons,
    in_sequence,
    remove_foldback,
    remove_heat_margin,
    scale_limits_while_following,
    scale_planner_limits,
)
from eval.mutants.situation import Mutant, Situation, check_off

BURDEN = {"payload.mass_kg": 4.0, "payload.carried_s": 1e6, "payload.free_s": 0.01}
"""kg, four times the payload of the draws."""
WORST = {
    "drives.torque_constant": 0.95,
    "drives.resistance": 1.15,
    "drives.winding_to_housing": 1.1,
    "drives.winding_capacity": 0.9,
}
"""The hottest motors that can be drawn."""

HELD = Situation(
    description="motors hot from work hold 4 kg at arm's length",
    policy=move_to(**FAR),
    draws=BURDEN | WORST,
    disturbance=hot_motors_at_start(86.0, 13.0),
    seconds=11.0,
)
SWING = cycle_poses(0.6, {"shoulder_lift": -1.9, "elbow": 0.9}, {"shoulder_lift": -1.2, "elbow": 0.9})

HEAT_GUARDS = (
    check_off("safety: heat", Reason.HEAT, "heat_hard", HELD),
    Mutant(
        guard="supervisor: heat is handled as category 2: power stays on",
        remove_guard=downgrade_to_category_2(Reason.HEAT),
        situation=HELD,
        monitor="heat_hard",
    ),
    Mutant(
        guard="heat: no margin of the computed winding temperature",
        remove_guard=remove_heat_margin,
        situation=HELD,
        monitor="heat_hard",
    ),
    Mutant(
        guard="heat: no foldback",
        remove_guard=remove_foldback,
        situation=Situation(
            description="planner four times as fast, unchecked, swings a hot arm with 4 kg; no heat check",
            policy=SWING,
            prepare=in_sequence(
                ignore_reasons(Reason.HEAT | Reason.ACCELERATION | Reason.TORQUE),
                scale_planner_limits(qdd_max=4.0),  # the planner reads how much speed the foldback leaves
            ),
            draws=BURDEN,
            disturbance=hot_motors_at_start(86.8, 21.0),
            seconds=8.0,
        ),
        monitor="heat_hard",
    ),
    Mutant(
        guard="safety: the torque check ignores the foldback of currents",
        remove_guard=check_with_all_current,
        situation=Situation(
            description="planner with twelve times the acceleration swings a hot, heavy arm; heat check off",
            policy=SWING,
            prepare=in_sequence(
                ignore_reasons(Reason.HEAT | Reason.ACCELERATION), scale_limits_while_following(qdd_max=12.0)
            ),
            draws=LIGHT | {"links.mass": 1.4, "joints.friction": 1.5} | BURDEN | {"payload.mass_kg": 5.0},
            disturbance=hot_motors_at_start(86.0, 21.0),
            seconds=2.0,
        ),
        monitor="torque",
    ),
    Mutant(
        guard="heat: lost current readings keep their last value",
        remove_guard=freeze_lost_currents,
        situation=replace(
            HELD,
            description="current readings are lost; then motors hot from work hold 4 kg at arm's length",
            faults=sensor_faults(Failure.OFF, 0.15, sensor="current"),
        ),
        monitor="heat_hard",
    ),
    Mutant(
        guard="heat: repeated current readings are accepted forever",
        remove_guard=accept_stuck_currents,
        situation=replace(
            HELD,
            description="current readings freeze; then motors hot from work hold 4 kg at arm's length",
            faults=sensor_faults(Failure.STUCK, 0.15, sensor="current"),
        ),
        monitor="heat_hard",
    ),
)
