"""Guards of the windings: by safety, by the observer of heat, and by the supervisor."""

from deploy.backends.sim.sensor_faults import Failure
from deploy.state import Reason
from eval.mutants.asks import heads, visits
from eval.mutants.befalls import begins_hot, fails
from eval.mutants.hostile import Situation
from eval.mutants.limits import FAR
from eval.mutants.mutant import Mutant
from eval.mutants.weakened import blind, deaf, forgiving, undoubting, unfolded, unwary

HZ = 200
BURDEN = {"payload.mass_kg": 4.0, "payload.carried_s": 1e6, "payload.free_s": 0.01}
"""kg, four times what robots are drawn with."""
WORST = {
    "drives.torque_constant": 0.95,
    "drives.resistance": 1.15,
    "drives.winding_to_housing": 1.1,
    "drives.winding_capacity": 0.9,
}
"""The hottest motors that can be drawn."""

HELD = Situation(
    words="motors hot from work hold 4 kg at arm's length",
    says=heads(**FAR),
    draws=BURDEN | WORST,
    befalls=begins_hot(86.0, 13.0),
    seconds=11.0,
)

WARMTH = (
    Mutant(
        guard="safety: heat, off",
        weaken=blind(Reason.HEAT),
        reasons=Reason.HEAT,
        situation=HELD,
        monitor="heat_hard",
    ),
    Mutant(
        guard="supervisor: heat is category 2: the power stays",
        weaken=forgiving(Reason.HEAT),
        situation=HELD,
        monitor="heat_hard",
    ),
    Mutant(
        guard="heat: a winding is believed to be no warmer than it is computed to be",
        weaken=undoubting,
        situation=HELD,
        monitor="heat_hard",
    ),
    Mutant(
        guard="heat: no foldback",
        weaken=unfolded,
        situation=Situation(
            words="a hot arm swings 4 kg to and fro as fast as it is let; safety is blind to heat",
            says=visits(0.6, {"shoulder_lift": -1.9, "elbow": 0.9}, {"shoulder_lift": -1.2, "elbow": 0.9}),
            prepare=blind(Reason.HEAT),
            draws=BURDEN,
            befalls=begins_hot(86.0, 21.0),
            seconds=8.0,
        ),
        monitor="heat_hard",
    ),
    Mutant(
        guard="heat: currents that are not heard stay as they were",
        weaken=deaf,
        situation=Situation(
            words="currents are no longer heard; then motors hot from work hold 4 kg at arm's length",
            says=heads(**FAR),
            draws=BURDEN | WORST,
            befalls=begins_hot(86.0, 13.0),
            faults=fails(Failure.OFF, 0.15, HZ, sensor="current"),
            seconds=11.0,
        ),
        monitor="heat_hard",
    ),
    Mutant(
        guard="heat: a current may repeat itself for ever",
        weaken=unwary,
        situation=Situation(
            words="currents stay as they were said; then motors hot from work hold 4 kg at arm's length",
            says=heads(**FAR),
            draws=BURDEN | WORST,
            befalls=begins_hot(86.0, 13.0),
            faults=fails(Failure.STUCK, 0.15, HZ, sensor="current"),
            seconds=11.0,
        ),
        monitor="heat_hard",
    ),
)
