"""Mutants of guards of estimates: sensor checks, filter gate and confirmation, load detection, arming."""

from deploy.backends.sim.sensor_faults import Failure
from deploy.reasons import Reason
from eval.mutants.attacks import (
    encoder_offset_at_start,
    hot_motors_at_start,
    jam_joint,
    move_slowly_to,
    move_to,
    push_link,
    sensor_faults,
    slipping_brakes,
)
from eval.mutants.guard_removal import (
    arm_while_moving,
    ignore_reasons,
    in_sequence,
    open_innovation_gate,
    trust_first_sample,
)
from eval.mutants.situation import LATCHES, Mutant, Situation, check_off

HOME = move_to()

ESTIMATION = (
    check_off(
        "safety: stale",
        Reason.STALE,
        "tracking",
        Situation(
            description="encoders stop sending, and a joint jams at 1.2 rad/s; load detection off",
            policy=move_slowly_to(1.2, wrist_3=2.7),
            prepare=ignore_reasons(Reason.LOAD),
            faults=sensor_faults(Failure.OFF, 0.8),
            disturbance=jam_joint(5, 0.85),
        ),
    ),
    check_off(
        "safety: lost",
        Reason.LOST,
        "tracking",
        Situation(
            description="encoders stop sending, and a joint jams at 0.8 rad/s; stale check and load detection off",
            policy=move_slowly_to(0.8, wrist_3=2.7),
            prepare=ignore_reasons(Reason.STALE | Reason.LOAD),
            faults=sensor_faults(Failure.OFF, 0.8),
            disturbance=jam_joint(5, 0.85),
        ),
    ),
    check_off(
        "safety: joint outside its range",
        Reason.OUTSIDE,
        "tracking",
        Situation(
            description="at the end of its range, a joint is pushed ever harder; load detection off",
            policy=move_to(wrist_1=0.3),
            prepare=ignore_reasons(Reason.LOAD),
            disturbance=push_link(3, (0.0, -1.0, 0.0), 1.5, 24.0, 8.0),
            seconds=2.6,
        ),
    ),
    check_off(
        "estimator: stuck",
        Reason.STUCK,
        "tracking",
        Situation(
            description="a joint jams, and its encoder repeats its reading; tracking and load checks off",
            policy=move_slowly_to(0.3, wrist_2=-0.6),
            prepare=ignore_reasons(Reason.TRACKING | Reason.LOAD),
            faults=sensor_faults(Failure.STUCK, 0.8, channel=4),
            disturbance=jam_joint(4, 0.8),
        ),
    ),
    check_off(
        "estimator: diverged",
        Reason.DIVERGED,
        "tracking",
        Situation(
            description="a joint jams at 0.9 rad/s; stale check and load detection off",
            policy=move_slowly_to(0.9, wrist_3=2.7),
            prepare=ignore_reasons(Reason.STALE | Reason.LOAD),
            disturbance=jam_joint(5, 0.85),
        ),
    ),
    check_off(
        "estimator: load",
        Reason.LOAD,
        "heat_hard",
        Situation(
            description="a hot motor drives a jammed joint slowly, with little tracking error; heat check off",
            policy=move_slowly_to(0.12, shoulder_pan=1.2),
            prepare=ignore_reasons(Reason.HEAT),
            disturbance=in_sequence(hot_motors_at_start(86.0, 21.0), jam_joint(0, 0.5)),
            seconds=4.0,
        ),
    ),
    Mutant(
        guard="estimator: no innovation gate",
        remove_guard=open_innovation_gate,
        situation=Situation(
            description="one packet of one encoder is off by 0.6 rad",
            policy=move_to(wrist_3=2.7),
            faults=sensor_faults(Failure.WRONG, 0.8, channel=5, ticks=1),
        ),
        monitor=LATCHES,
    ),
    Mutant(
        guard="estimator: accepted from the first sample on",
        remove_guard=trust_first_sample,
        situation=Situation(
            description="the first packets are off by 0.6 rad, and the operator arms at once",
            policy=HOME,
            disturbance=encoder_offset_at_start(5, 0.6),
            arm_at_once=True,
            seconds=0.6,
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="runtime: a moving robot is armed",
        remove_guard=arm_while_moving,
        reasons=Reason.MOVING,
        situation=Situation(
            description="brakes slip and the arm sinks during arming",
            policy=HOME,
            disturbance=slipping_brakes(0.1),
            seconds=0.45,
        ),
        monitor="torque",
    ),
)
