"""Guards of what is believed: by the estimator, by what asks it, and by the supervisor."""

from deploy.backends.sim.sensor_faults import Failure
from deploy.state import Reason
from eval.mutants.disturbances import (
    apply_all,
    encoder_offset_at_start,
    hot_motors_at_start,
    jam_joint,
    push_link,
    sensor_faults,
    slipping_brakes,
)
from eval.mutants.guard_removal import (
    arm_while_moving,
    ignore_reasons,
    open_innovation_gate,
    trust_first_sample,
)
from eval.mutants.hostile_policies import move_slowly_to, move_to
from eval.mutants.mutant import LATCHES, Mutant
from eval.mutants.situation import Situation

HOME = move_to()
HZ = 200

ESTIMATION = (
    Mutant(
        guard="safety: stale, off",
        weaken=ignore_reasons(Reason.STALE),
        reasons=Reason.STALE,
        situation=Situation(
            words="encoders fall silent, and a joint jams at 1.2 rad/s; nobody minds loads",
            says=move_slowly_to(1.2, wrist_3=2.7),
            prepare=ignore_reasons(Reason.LOAD),
            faults=sensor_faults(Failure.OFF, 0.8, HZ),
            befalls=jam_joint(5, 0.85),
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="safety: lost, off",
        weaken=ignore_reasons(Reason.LOST),
        reasons=Reason.LOST,
        situation=Situation(
            words="encoders fall silent, and a joint jams at 0.8 rad/s; nobody minds staleness or loads",
            says=move_slowly_to(0.8, wrist_3=2.7),
            prepare=ignore_reasons(Reason.STALE | Reason.LOAD),
            faults=sensor_faults(Failure.OFF, 0.8, HZ),
            befalls=jam_joint(5, 0.85),
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="safety: outside, off",
        weaken=ignore_reasons(Reason.OUTSIDE),
        reasons=Reason.OUTSIDE,
        situation=Situation(
            words="at the end of its range, a joint is pushed ever harder; nobody minds loads",
            says=move_to(wrist_1=0.3),
            prepare=ignore_reasons(Reason.LOAD),
            befalls=push_link(3, (0.0, -1.0, 0.0), 1.5, 24.0, 8.0),
            seconds=2.6,
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="estimator: stuck, off",
        weaken=ignore_reasons(Reason.STUCK),
        reasons=Reason.STUCK,
        situation=Situation(
            words="a joint's electronics hang: it jams, and its encoder repeats itself; nobody minds lags or loads",
            says=move_slowly_to(0.3, wrist_2=-0.6),
            prepare=ignore_reasons(Reason.TRACKING | Reason.LOAD),
            faults=sensor_faults(Failure.STUCK, 0.8, HZ, channel=4),
            befalls=jam_joint(4, 0.8),
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="estimator: diverged, off",
        weaken=ignore_reasons(Reason.DIVERGED),
        reasons=Reason.DIVERGED,
        situation=Situation(
            words="a joint jams at 0.9 rad/s; nobody minds staleness or loads",
            says=move_slowly_to(0.9, wrist_3=2.7),
            prepare=ignore_reasons(Reason.STALE | Reason.LOAD),
            befalls=jam_joint(5, 0.85),
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="estimator: load, off",
        weaken=ignore_reasons(Reason.LOAD),
        reasons=Reason.LOAD,
        situation=Situation(
            words="a hot motor drags a joint that jams, slowly enough for it to hardly lag; nobody minds heat",
            says=move_slowly_to(0.12, shoulder_pan=1.2),
            prepare=ignore_reasons(Reason.HEAT),
            befalls=apply_all(hot_motors_at_start(86.0, 21.0), jam_joint(0, 0.5)),
            seconds=4.0,
        ),
        monitor="heat_hard",
    ),
    Mutant(
        guard="estimator: no gate",
        weaken=open_innovation_gate,
        situation=Situation(
            words="one packet of one encoder is off by 0.6 rad",
            says=move_to(wrist_3=2.7),
            faults=sensor_faults(Failure.WRONG, 0.8, HZ, channel=5, until=0.805),
        ),
        monitor=LATCHES,
    ),
    Mutant(
        guard="estimator: believed from the first sample on",
        weaken=trust_first_sample,
        situation=Situation(
            words="the first packets are off by 0.6 rad, and the operator arms at once",
            says=HOME,
            befalls=encoder_offset_at_start(5, 0.6),
            arm_s=0.005,
            seconds=0.6,
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="runtime: a robot that moves is armed",
        weaken=arm_while_moving,
        reasons=Reason.MOVING,
        situation=Situation(
            words="brakes slip and the arm sinks as the operator arms it",
            says=HOME,
            befalls=slipping_brakes(0.1),
            seconds=0.45,
        ),
        monitor="torque",
    ),
)
