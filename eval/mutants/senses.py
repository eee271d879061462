"""Guards of what is believed: by the estimator, by what asks it, and by the supervisor."""

from deploy.backends.sim.sensor_faults import Failure
from deploy.state import Reason
from eval.mutants.asks import creeps, heads
from eval.mutants.befalls import begins_hot, begins_wrong, fails, jams, leans, sinks, together
from eval.mutants.hostile import Situation
from eval.mutants.mutant import LATCHES, Mutant
from eval.mutants.weakened import blind, gateless, hasty, restless

HOME = heads()
HZ = 200

SENSES = (
    Mutant(
        guard="safety: stale, off",
        weaken=blind(Reason.STALE),
        reasons=Reason.STALE,
        situation=Situation(
            words="encoders fall silent, and a joint jams at 1.2 rad/s; nobody minds loads",
            says=creeps(1.2, wrist_3=2.7),
            prepare=blind(Reason.LOAD),
            faults=fails(Failure.OFF, 0.8, HZ),
            befalls=jams(5, 0.85),
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="safety: lost, off",
        weaken=blind(Reason.LOST),
        reasons=Reason.LOST,
        situation=Situation(
            words="encoders fall silent, and a joint jams at 0.8 rad/s; nobody minds staleness or loads",
            says=creeps(0.8, wrist_3=2.7),
            prepare=blind(Reason.STALE | Reason.LOAD),
            faults=fails(Failure.OFF, 0.8, HZ),
            befalls=jams(5, 0.85),
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="safety: outside, off",
        weaken=blind(Reason.OUTSIDE),
        reasons=Reason.OUTSIDE,
        situation=Situation(
            words="at the end of its range, a joint is pushed ever harder; nobody minds loads",
            says=heads(wrist_1=0.3),
            prepare=blind(Reason.LOAD),
            befalls=leans(3, (0.0, -1.0, 0.0), 1.5, 24.0, 8.0),
            seconds=2.6,
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="estimator: stuck, off",
        weaken=blind(Reason.STUCK),
        reasons=Reason.STUCK,
        situation=Situation(
            words="a joint's electronics hang: it jams, and its encoder repeats itself; nobody minds lags or loads",
            says=creeps(0.3, wrist_2=-0.6),
            prepare=blind(Reason.TRACKING | Reason.LOAD),
            faults=fails(Failure.STUCK, 0.8, HZ, channel=4),
            befalls=jams(4, 0.8),
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="estimator: diverged, off",
        weaken=blind(Reason.DIVERGED),
        reasons=Reason.DIVERGED,
        situation=Situation(
            words="a joint jams at 0.9 rad/s; nobody minds staleness or loads",
            says=creeps(0.9, wrist_3=2.7),
            prepare=blind(Reason.STALE | Reason.LOAD),
            befalls=jams(5, 0.85),
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="estimator: load, off",
        weaken=blind(Reason.LOAD),
        reasons=Reason.LOAD,
        situation=Situation(
            words="a hot motor drags a joint that jams, slowly enough for it to hardly lag; nobody minds heat",
            says=creeps(0.12, shoulder_pan=1.2),
            prepare=blind(Reason.HEAT),
            befalls=together(begins_hot(86.0, 21.0), jams(0, 0.5)),
            seconds=4.0,
        ),
        monitor="heat_hard",
    ),
    Mutant(
        guard="estimator: no gate",
        weaken=gateless,
        situation=Situation(
            words="one packet of one encoder is off by 0.6 rad",
            says=heads(wrist_3=2.7),
            faults=fails(Failure.WRONG, 0.8, HZ, channel=5, until=0.805),
        ),
        monitor=LATCHES,
    ),
    Mutant(
        guard="estimator: believed from the first sample on",
        weaken=hasty,
        situation=Situation(
            words="the first packets are off by 0.6 rad, and the operator arms at once",
            says=HOME,
            befalls=begins_wrong(5, 0.6),
            arm_s=0.005,
            seconds=0.6,
        ),
        monitor="tracking",
    ),
    Mutant(
        guard="runtime: a robot that moves is armed",
        weaken=restless,
        reasons=Reason.MOVING,
        situation=Situation(
            words="brakes slip and the arm sinks as the operator arms it",
            says=HOME,
            befalls=sinks(0.1),
            seconds=0.45,
        ),
        monitor="torque",
    ),
)
