"""Guards of what is sent: by safety, by the planner, by the action, and by the runtime itself."""

from deploy.state import Reason
from eval.mutants.disturbances import jam_joint
from eval.mutants.guard_removal import (
    follow_non_finite_action,
    ignore_non_finite_action,
    ignore_reasons,
    ignore_speed_overshoot,
    plan_nan_at,
    remove_action_clip,
    remove_all,
    remove_leash,
    scale_limits_while_following,
    scale_planner_limits,
    send_non_finite,
    skip_stop_checks,
    stop_instantly,
    widen_target_range,
)
from eval.mutants.hostile_policies import (
    action_spike,
    cycle_poses,
    move_slowly_to,
    move_to,
    nan_after,
    switch_policy,
    turn_last_joint,
)
from eval.mutants.mutant import INVALID, Mutant
from eval.mutants.situation import Situation

FAR = {"shoulder_lift": -0.5, "elbow": 0.6, "wrist_1": -1.94}
"""The arm stretched almost level, 0.93 m from its axis."""
LIGHT = {
    "links.mass": 0.85,
    "links.length": 1.0,
    "links.com_m": 0.0,
    "joints.friction": 0.5,
    "joints.damping": 0.5,
    "joints.armature": 1.0,
    "drives.torque_constant": 1.0,
    "drives.kp": 1.0,
    "drives.kd": 1.0,
    "drives.delay_s": 0.0,
    "payload.mass_kg": 0.0,
    "cable.stiffness_n_per_m": 0.0,
}
"""Robots that need less torque than their model says: others need more, and friction beside, than `margins.tau` leaves
to a planner as wild as the one that safety is to hold here."""
TABLE = Situation(words="the tool is let down to the table", says=move_to(shoulder_lift=-0.35, elbow=0.68))
WRIST = Situation(
    words="a wrist is driven into the table, the tool above it",
    says=move_to(shoulder_lift=-0.35, wrist_1=0.25),
)
SPIN = move_to(wrist_3=2.8)
TO_AND_FRO = cycle_poses(2.0, {"wrist_3": -2.8}, {"wrist_3": 2.8})
NO_NUMBER = Reason.NOT_FINITE | Reason.COLLISION
"""Shapes that are nowhere count as too near."""

SAFETY = (
    Mutant(
        guard="safety: position, off",
        weaken=ignore_reasons(Reason.POSITION),
        reasons=Reason.POSITION,
        situation=Situation(
            words="a joint is to go beyond its range; the planner does not clamp",
            says=move_to(wrist_3=3.3),
            prepare=widen_target_range,
            seconds=3.0,
        ),
        monitor="position_hard",
    ),
    Mutant(
        guard="safety: velocity, off",
        weaken=ignore_reasons(Reason.VELOCITY),
        reasons=Reason.VELOCITY,
        situation=Situation(
            words="a planner that is 30 % too fast, and gets there gently",
            says=TO_AND_FRO,
            prepare=scale_planner_limits(qd_max=1.3, qdd_max=0.3),
            seconds=4.5,
        ),
        monitor="velocity",
    ),
    Mutant(
        guard="safety: the speed that a stop would still gain is not looked at",
        weaken=ignore_speed_overshoot,
        situation=Situation(
            words="the policy says NaN while a planner with four times the jerk gathers speed",
            says=nan_after(0.54, wrist_3=2.8),
            prepare=scale_limits_while_following(qddd_max=4.0),
            seconds=1.0,
        ),
        monitor="velocity_sent",
    ),
    Mutant(
        guard="safety: torque, off",
        weaken=ignore_reasons(Reason.TORQUE),
        reasons=Reason.TORQUE,
        situation=Situation(
            words="a planner that may accelerate four times as hard, on light robots with little friction",
            says=switch_policy(
                1.9, move_slowly_to(0.8, **FAR), move_to(shoulder_lift=-1.4, elbow=0.6, wrist_1=-1.94)
            ),
            prepare=remove_all(
                ignore_reasons(Reason.TOOL_SPEED | Reason.SINGULARITY),
                scale_limits_while_following(qdd_max=4.0, qddd_max=0.8),
            ),
            draws=LIGHT,
            seconds=2.6,
        ),
        monitor="torque",
    ),
    Mutant(
        guard="safety: workspace, off",
        weaken=ignore_reasons(Reason.WORKSPACE),
        reasons=Reason.WORKSPACE,
        situation=TABLE,
        monitor="workspace",
    ),
    Mutant(
        guard="safety: collision, off",
        weaken=ignore_reasons(Reason.COLLISION),
        reasons=Reason.COLLISION,
        situation=WRIST,
        monitor="self_collision",
    ),
    Mutant(
        guard="safety: singularity, off",
        weaken=ignore_reasons(Reason.SINGULARITY),
        reasons=Reason.SINGULARITY,
        situation=Situation(
            words="the arm is to turn over backwards, through a singularity",
            says=move_to(shoulder_lift=-2.35, elbow=0.35),
        ),
        monitor="singularity",
    ),
    Mutant(
        guard="safety: tool speed, off",
        weaken=ignore_reasons(Reason.TOOL_SPEED),
        reasons=Reason.TOOL_SPEED,
        situation=Situation(
            words="the stretched arm sweeps from side to side",
            says=cycle_poses(2.0, FAR | {"shoulder_pan": -1.2}, FAR | {"shoulder_pan": 1.2}),
            seconds=4.0,
        ),
        monitor="tool_speed",
    ),
    Mutant(
        guard="safety: tracking, off",
        weaken=ignore_reasons(Reason.TRACKING),
        reasons=Reason.TRACKING,
        situation=Situation(
            words="the elbow jams, so that the shoulder lets the tool down to the table; nobody minds loads",
            says=move_slowly_to(0.3, shoulder_lift=-0.35, elbow=0.5),
            prepare=ignore_reasons(Reason.LOAD),
            befalls=jam_joint(2, 0.5),
            seconds=4.5,
        ),
        monitor="workspace",
    ),
    Mutant(
        guard="safety: numbers, off",
        weaken=ignore_reasons(Reason.NOT_FINITE),
        reasons=Reason.NOT_FINITE,
        situation=Situation(
            words="a planned speed is no number; safety is blind to poses that are none",
            says=SPIN,
            prepare=remove_all(plan_nan_at(0.8, angles=False), ignore_reasons(Reason.COLLISION)),
            seconds=1.2,
        ),
        monitor=INVALID,
    ),
    Mutant(
        guard="safety: the stop's first step, middle and end are not looked at",
        weaken=skip_stop_checks(ahead=False, mid_stop=False, rest=False),
        situation=TABLE,
        monitor="workspace",
    ),
    Mutant(
        guard="safety: the stop's end is not looked at",
        weaken=skip_stop_checks(rest=False),
        situation=WRIST,
        monitor="self_collision",
    ),
)

SENT = (
    Mutant(
        guard="planner: targets are not clamped",
        weaken=widen_target_range,
        situation=Situation(
            words="a joint is to go beyond its range; safety is blind to positions",
            says=move_to(wrist_3=3.3),
            prepare=ignore_reasons(Reason.POSITION),
            seconds=3.0,
        ),
        monitor="position_hard",
    ),
    Mutant(
        guard="planner: speed × 1.3",
        weaken=scale_planner_limits(qd_max=1.3),
        situation=Situation(
            words="a joint goes as fast as it is let; safety is blind to speed",
            says=TO_AND_FRO,
            prepare=ignore_reasons(Reason.VELOCITY),
            seconds=4.0,
        ),
        monitor="velocity_sent",
    ),
    Mutant(
        guard="planner: acceleration × 1.2",
        weaken=scale_planner_limits(qdd_max=1.2),
        situation=Situation(words="a joint goes as fast as it is let", says=SPIN),
        monitor="acceleration",
    ),
    Mutant(
        guard="planner: jerk × 1.2",
        weaken=scale_planner_limits(qddd_max=1.2),
        situation=Situation(words="a joint goes as fast as it is let", says=SPIN),
        monitor="jerk",
    ),
    Mutant(
        guard="runtime: a refusal is answered by standing still, not by the stop that was prepared",
        weaken=stop_instantly,
        situation=TABLE,
        monitor="jerk",
    ),
    Mutant(
        guard="runtime: what is no number is sent",
        weaken=send_non_finite,
        situation=Situation(
            words="a planned setpoint is no number; safety is blind to that",
            says=SPIN,
            prepare=remove_all(plan_nan_at(0.8, angles=True), ignore_reasons(NO_NUMBER)),
            seconds=1.2,
        ),
        monitor=INVALID,
    ),
    Mutant(
        guard="runtime: a policy that says no number is not stopped",
        weaken=ignore_non_finite_action,
        reasons=Reason.NOT_FINITE,
        situation=Situation(
            words="the policy says NaN from some tick on", says=nan_after(0.8, wrist_3=2.7), seconds=1.6
        ),
        monitor="action_finite",
    ),
    Mutant(
        guard="action: NaN moves the target",
        weaken=follow_non_finite_action,
        situation=Situation(
            words="the policy says NaN from some tick on", says=nan_after(0.8, wrist_3=2.7), seconds=1.6
        ),
        monitor="position_requested",
    ),
    Mutant(
        guard="action: no clip",
        weaken=remove_action_clip,
        situation=Situation(
            words="near the end of a range, the policy says 100 for a moment",
            says=action_spike(2.2, 2.22, wrist_3=2.7),
            scale=0.05,
            leash=0.3,
            seconds=2.6,
        ),
        monitor="position_requested",
    ),
    Mutant(
        guard="action: no leash",
        weaken=remove_leash,
        situation=Situation(
            words="the policy asks faster than a joint can follow",
            says=turn_last_joint(0.62),
            scale=0.2,
            leash=0.3,
            seconds=1.5,
        ),
        monitor="position_requested",
    ),
)
