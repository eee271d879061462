"""Guards of what is sent: by safety, by the planner, by the action, and by the runtime itself."""

from deploy.state import Reason
from eval.mutants.asks import creeps, falls_silent, heads, shouts, then, turns, visits
from eval.mutants.befalls import jams
from eval.mutants.hostile import Situation
from eval.mutants.mutant import INVALID, Mutant
from eval.mutants.weakened import (
    abrupt,
    blind,
    both,
    careless,
    credulous,
    looks,
    planless,
    planner,
    rash,
    unbarred,
    unclamped,
    unclipped,
    unforeseen,
    unleashed,
)

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
TABLE = Situation(words="the tool is let down to the table", says=heads(shoulder_lift=-0.35, elbow=0.68))
WRIST = Situation(
    words="a wrist is driven into the table, the tool above it", says=heads(shoulder_lift=-0.35, wrist_1=0.25)
)
SPIN = heads(wrist_3=2.8)
TO_AND_FRO = visits(2.0, {"wrist_3": -2.8}, {"wrist_3": 2.8})
NO_NUMBER = Reason.NOT_FINITE | Reason.COLLISION
"""Shapes that are nowhere count as too near."""

SAFETY = (
    Mutant(
        guard="safety: position, off",
        weaken=blind(Reason.POSITION),
        reasons=Reason.POSITION,
        situation=Situation(
            words="a joint is to go beyond its range; the planner does not clamp",
            says=heads(wrist_3=3.3),
            prepare=unclamped,
            seconds=3.0,
        ),
        monitor="position_hard",
    ),
    Mutant(
        guard="safety: velocity, off",
        weaken=blind(Reason.VELOCITY),
        reasons=Reason.VELOCITY,
        situation=Situation(
            words="a planner that is 30 % too fast, and gets there gently",
            says=TO_AND_FRO,
            prepare=planner(qd_max=1.3, qdd_max=0.3),
            seconds=4.5,
        ),
        monitor="velocity",
    ),
    Mutant(
        guard="safety: the speed that a stop would still gain is not looked at",
        weaken=unforeseen,
        situation=Situation(
            words="the policy says NaN while a planner with four times the jerk gathers speed",
            says=falls_silent(0.54, wrist_3=2.8),
            prepare=rash(qddd_max=4.0),
            seconds=1.0,
        ),
        monitor="velocity_sent",
    ),
    Mutant(
        guard="safety: torque, off",
        weaken=blind(Reason.TORQUE),
        reasons=Reason.TORQUE,
        situation=Situation(
            words="a planner that may accelerate four times as hard, on light robots with little friction",
            says=then(1.9, creeps(0.8, **FAR), heads(shoulder_lift=-1.4, elbow=0.6, wrist_1=-1.94)),
            prepare=both(blind(Reason.TOOL_SPEED | Reason.SINGULARITY), rash(qdd_max=4.0, qddd_max=0.8)),
            draws=LIGHT,
            seconds=2.6,
        ),
        monitor="torque",
    ),
    Mutant(
        guard="safety: workspace, off",
        weaken=blind(Reason.WORKSPACE),
        reasons=Reason.WORKSPACE,
        situation=TABLE,
        monitor="workspace",
    ),
    Mutant(
        guard="safety: collision, off",
        weaken=blind(Reason.COLLISION),
        reasons=Reason.COLLISION,
        situation=WRIST,
        monitor="self_collision",
    ),
    Mutant(
        guard="safety: singularity, off",
        weaken=blind(Reason.SINGULARITY),
        reasons=Reason.SINGULARITY,
        situation=Situation(
            words="the arm is to turn over backwards, through a singularity",
            says=heads(shoulder_lift=-2.35, elbow=0.35),
        ),
        monitor="singularity",
    ),
    Mutant(
        guard="safety: tool speed, off",
        weaken=blind(Reason.TOOL_SPEED),
        reasons=Reason.TOOL_SPEED,
        situation=Situation(
            words="the stretched arm sweeps from side to side",
            says=visits(2.0, FAR | {"shoulder_pan": -1.2}, FAR | {"shoulder_pan": 1.2}),
            seconds=4.0,
        ),
        monitor="tool_speed",
    ),
    Mutant(
        guard="safety: tracking, off",
        weaken=blind(Reason.TRACKING),
        reasons=Reason.TRACKING,
        situation=Situation(
            words="the elbow jams, so that the shoulder lets the tool down to the table; nobody minds loads",
            says=creeps(0.3, shoulder_lift=-0.35, elbow=0.5),
            prepare=blind(Reason.LOAD),
            befalls=jams(2, 0.5),
            seconds=4.5,
        ),
        monitor="workspace",
    ),
    Mutant(
        guard="safety: numbers, off",
        weaken=blind(Reason.NOT_FINITE),
        reasons=Reason.NOT_FINITE,
        situation=Situation(
            words="a planned speed is no number; safety is blind to poses that are none",
            says=SPIN,
            prepare=both(planless(0.8, angles=False), blind(Reason.COLLISION)),
            seconds=1.2,
        ),
        monitor=INVALID,
    ),
    Mutant(
        guard="safety: the stop's first step, midst and end are not looked at",
        weaken=looks(ahead=False, midst=False, rest=False),
        situation=TABLE,
        monitor="workspace",
    ),
    Mutant(
        guard="safety: the stop's end is not looked at",
        weaken=looks(rest=False),
        situation=WRIST,
        monitor="self_collision",
    ),
)

SENT = (
    Mutant(
        guard="planner: targets are not clamped",
        weaken=unclamped,
        situation=Situation(
            words="a joint is to go beyond its range; safety is blind to positions",
            says=heads(wrist_3=3.3),
            prepare=blind(Reason.POSITION),
            seconds=3.0,
        ),
        monitor="position_hard",
    ),
    Mutant(
        guard="planner: speed × 1.3",
        weaken=planner(qd_max=1.3),
        situation=Situation(
            words="a joint goes as fast as it is let; safety is blind to speed",
            says=TO_AND_FRO,
            prepare=blind(Reason.VELOCITY),
            seconds=4.0,
        ),
        monitor="velocity_sent",
    ),
    Mutant(
        guard="planner: acceleration × 1.2",
        weaken=planner(qdd_max=1.2),
        situation=Situation(words="a joint goes as fast as it is let", says=SPIN),
        monitor="acceleration",
    ),
    Mutant(
        guard="planner: jerk × 1.2",
        weaken=planner(qddd_max=1.2),
        situation=Situation(words="a joint goes as fast as it is let", says=SPIN),
        monitor="jerk",
    ),
    Mutant(
        guard="runtime: a refusal is answered by standing still, not by the stop that was prepared",
        weaken=abrupt,
        situation=TABLE,
        monitor="jerk",
    ),
    Mutant(
        guard="runtime: what is no number is sent",
        weaken=unbarred,
        situation=Situation(
            words="a planned setpoint is no number; safety is blind to that",
            says=SPIN,
            prepare=both(planless(0.8, angles=True), blind(NO_NUMBER)),
            seconds=1.2,
        ),
        monitor=INVALID,
    ),
    Mutant(
        guard="runtime: a policy that says no number is not stopped",
        weaken=careless,
        reasons=Reason.NOT_FINITE,
        situation=Situation(
            words="the policy says NaN from some tick on", says=falls_silent(0.8, wrist_3=2.7), seconds=1.6
        ),
        monitor="action_finite",
    ),
    Mutant(
        guard="action: NaN moves the target",
        weaken=credulous,
        situation=Situation(
            words="the policy says NaN from some tick on", says=falls_silent(0.8, wrist_3=2.7), seconds=1.6
        ),
        monitor="position_requested",
    ),
    Mutant(
        guard="action: no clip",
        weaken=unclipped,
        situation=Situation(
            words="near the end of a range, the policy says 100 for a moment",
            says=shouts(2.2, 2.22, wrist_3=2.7),
            scale=0.05,
            leash=0.3,
            seconds=2.6,
        ),
        monitor="position_requested",
    ),
    Mutant(
        guard="action: no leash",
        weaken=unleashed,
        situation=Situation(
            words="the policy asks faster than a joint can follow",
            says=turns(0.62),
            scale=0.2,
            leash=0.3,
            seconds=1.5,
        ),
        monitor="position_requested",
    ),
)
