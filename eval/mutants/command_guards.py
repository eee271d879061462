"""Mutants of guards of commands: safety checks, planner limits, action clip and leash, and the runtime."""

from deploy.reasons import Reason
from eval.faults.hostile_policy import push_joints
from eval.mutants.attacks import (
    action_spike,
    cycle_poses,
    in_turn,
    jam_joint,
    move_slowly_to,
    move_to,
    nan_after,
    switch_policy,
    turn_last_joint,
)
from eval.mutants.guard_removal import (
    follow_non_finite_action,
    ignore_non_finite_action,
    ignore_reasons,
    ignore_speed_overshoot,
    in_sequence,
    plan_nan_at,
    remove_action_clip,
    remove_leash,
    scale_limits_while_following,
    scale_planner_limits,
    send_non_finite,
    skip_stop_checks,
    stop_instantly,
    widen_target_range,
)
from eval.mutants.situation import INVALID, SEED, Mutant, Situation, check_off

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
"""Robots that need less torque than the model. For others the torque margin of `margins.tau` is exceeded anyway by the
planner with scaled limits."""
TABLE = Situation(
    description="the tool is lowered to the table", policy=move_to(shoulder_lift=-0.35, elbow=0.68)
)
WRIST = Situation(
    description="a wrist is driven into the table, the tool above it",
    policy=move_to(shoulder_lift=-0.35, wrist_1=0.25),
)
HIGH = {"shoulder_lift": -0.794, "elbow": 1.57, "wrist_1": 0.173, "wrist_2": -1.94}
LOWER = HIGH | {"elbow": 2.6}
LIFT = LOWER | {"shoulder_lift": -0.32}
TURN = LIFT | {"wrist_2": -2.55}
DIP = Situation(
    description="elbow and wrists lower a link while the slower shoulder lifts it: a stop would go through the table",
    policy=in_turn(
        (0.0, HIGH), (2.0, LOWER), (2.228, LIFT), (2.303, TURN), (2.715, TURN | {"wrist_1": -2.95})
    ),
    seconds=4.0,
)
SPIN = move_to(wrist_3=2.8)
TO_AND_FRO = cycle_poses(2.0, {"wrist_3": -2.8}, {"wrist_3": 2.8})
FAST_JOINT = Situation(description="a joint moves as fast as allowed", policy=SPIN)
NAN_ACTIONS = Situation(
    description="NaN actions from some tick on", policy=nan_after(0.8, wrist_3=2.7), seconds=1.6
)
NO_NUMBER = Reason.NOT_FINITE | Reason.COLLISION
"""Shapes without a finite position count as too close."""

SAFETY = (
    check_off(
        "safety: position",
        Reason.POSITION,
        "position_hard",
        Situation(
            description="target beyond a joint's range; the planner does not clamp",
            policy=move_to(wrist_3=3.3),
            prepare=widen_target_range,
            seconds=3.0,
        ),
    ),
    check_off(
        "safety: velocity",
        Reason.VELOCITY,
        "velocity",
        Situation(
            description="planner 30 % too fast, with low acceleration",
            policy=TO_AND_FRO,
            prepare=scale_planner_limits(qd_max=1.5, qdd_max=0.3),
            seconds=4.5,
        ),
    ),
    check_off(
        "safety: acceleration",
        Reason.ACCELERATION,
        "acceleration",
        Situation(
            description="planner with 20 % too much acceleration",
            policy=TO_AND_FRO,
            prepare=scale_planner_limits(qdd_max=1.2),
            seconds=2.0,
        ),
    ),
    Mutant(
        guard="safety: the further increase of speed during a stop is not checked",
        remove_guard=ignore_speed_overshoot,
        situation=Situation(
            description="NaN actions; planner with four times the jerk and three times the acceleration, unchecked; the"
            " moments while a stop brakes are not checked",
            policy=nan_after(0.34, wrist_3=2.8),
            prepare=in_sequence(
                skip_stop_checks("braking"),
                ignore_reasons(Reason.ACCELERATION),
                scale_limits_while_following(qdd_max=3.0, qddd_max=4.0),
            ),
            seconds=1.0,
        ),
        monitor="velocity_sent",
    ),
    check_off(
        "safety: torque",
        Reason.TORQUE,
        "torque",
        Situation(
            description="planner with much more acceleration and jerk, on light robots with little friction",
            policy=switch_policy(
                1.9, move_slowly_to(0.8, **FAR), move_to(shoulder_lift=-1.4, elbow=0.6, wrist_1=-1.94)
            ),
            prepare=in_sequence(
                ignore_reasons(Reason.ACCELERATION | Reason.TOOL_SPEED | Reason.SINGULARITY),
                scale_limits_while_following(qdd_max=12.0, qddd_max=2.5),
            ),
            draws=LIGHT,
            seconds=2.6,
        ),
    ),
    check_off("safety: workspace", Reason.WORKSPACE, "workspace", TABLE),
    check_off("safety: collision", Reason.COLLISION, "self_collision", WRIST),
    check_off(
        "safety: singularity",
        Reason.SINGULARITY,
        "singularity",
        Situation(
            description="motion backwards through a singularity",
            policy=move_to(shoulder_lift=-2.35, elbow=0.35),
        ),
    ),
    check_off(
        "safety: tool speed",
        Reason.TOOL_SPEED,
        "tool_speed",
        Situation(
            description="targets far to either side of all joints, by chance, one or two a second",
            policy=push_joints(0.8, SEED + 1),
            seconds=15.0,
        ),
    ),
    check_off(
        "safety: tracking",
        Reason.TRACKING,
        "workspace",
        Situation(
            description="the elbow jams, so that the shoulder lowers the tool to the table; load detection off",
            policy=move_slowly_to(0.3, shoulder_lift=-0.35, elbow=0.5),
            prepare=ignore_reasons(Reason.LOAD),
            disturbance=jam_joint(2, 0.5),
            seconds=4.5,
        ),
    ),
    check_off(
        "safety: finite numbers",
        Reason.NOT_FINITE,
        INVALID,
        Situation(
            description="a planned velocity is NaN; collision check off",
            policy=SPIN,
            prepare=in_sequence(plan_nan_at(0.8, angles=False), ignore_reasons(Reason.COLLISION)),
            seconds=1.2,
        ),
    ),
    Mutant(
        guard="safety: the moments while a stop brakes are not checked",
        remove_guard=skip_stop_checks("braking"),
        situation=DIP,
        monitor="self_collision",
    ),
    Mutant(
        guard="safety: the stop's first step, the moments while it brakes and its end are not checked",
        remove_guard=skip_stop_checks(),
        situation=TABLE,
        monitor="workspace",
    ),
    Mutant(
        guard="safety: the end of the stop is not checked",
        remove_guard=skip_stop_checks("rest"),
        situation=WRIST,
        monitor="self_collision",
    ),
)

SENT = (
    Mutant(
        guard="planner: targets are not clamped",
        remove_guard=widen_target_range,
        situation=Situation(
            description="target beyond a joint's range; position check off",
            policy=move_to(wrist_3=3.3),
            prepare=ignore_reasons(Reason.POSITION),
            seconds=3.0,
        ),
        monitor="position_hard",
    ),
    Mutant(
        guard="planner: speed × 1.5",
        remove_guard=scale_planner_limits(qd_max=1.5),
        situation=Situation(
            description="a joint moves as fast as allowed; velocity check off",
            policy=TO_AND_FRO,
            prepare=ignore_reasons(Reason.VELOCITY),
            seconds=4.0,
        ),
        monitor="velocity_sent",
    ),
    Mutant(
        guard="planner: acceleration × 1.2",
        remove_guard=scale_planner_limits(qdd_max=1.2),
        situation=Situation(
            description="a joint moves as fast as allowed; acceleration check off",
            policy=SPIN,
            prepare=ignore_reasons(Reason.ACCELERATION),
        ),
        monitor="acceleration",
    ),
    Mutant(
        guard="planner: jerk × 1.2",
        remove_guard=scale_planner_limits(qddd_max=1.2),
        situation=FAST_JOINT,
        monitor="jerk",
    ),
    Mutant(
        guard="runtime: zero velocity after a refused setpoint instead of the prepared stop",
        remove_guard=stop_instantly,
        situation=TABLE,
        monitor="jerk",
    ),
    Mutant(
        guard="runtime: non-finite setpoints are sent",
        remove_guard=send_non_finite,
        situation=Situation(
            description="a planned setpoint is NaN; its checks off",
            policy=SPIN,
            prepare=in_sequence(plan_nan_at(0.8, angles=True), ignore_reasons(NO_NUMBER)),
            seconds=1.2,
        ),
        monitor=INVALID,
    ),
    Mutant(
        guard="runtime: a non-finite action does not stop the robot",
        remove_guard=ignore_non_finite_action,
        reasons=Reason.NOT_FINITE,
        situation=NAN_ACTIONS,
        monitor="action_finite",
    ),
    Mutant(
        guard="action: NaN moves the target",
        remove_guard=follow_non_finite_action,
        situation=NAN_ACTIONS,
        monitor="position_requested",
    ),
    Mutant(
        guard="action: no clip",
        remove_guard=remove_action_clip,
        situation=Situation(
            description="an action of 100 for a moment, near the end of a range",
            policy=action_spike(2.2, 2.22, wrist_3=2.7),
            scale=0.05,
            leash=0.3,
            seconds=2.6,
        ),
        monitor="position_requested",
    ),
    Mutant(
        guard="action: no leash",
        remove_guard=remove_leash,
        situation=Situation(
            description="targets move faster than a joint can follow",
            policy=turn_last_joint(0.62),
            scale=0.2,
            leash=0.3,
            seconds=1.5,
        ),
        monitor="position_requested",
    ),
)
