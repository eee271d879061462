"""Section "limitations": what the counts cannot show, and what the simulation does not model."""

from collections.abc import Iterator

import numpy as np

from eval.judge.counts import Counts
from eval.report.schema.rows import Evidence

LOAD_USED = 0.5
"""Monitors whose limit no robot used to this share are listed."""


NOT_SIMULATED = (
    "Links, gears and ground are rigid: no bending, vibration or thermal expansion.",
    "Friction does not depend on load or temperature, and motors have no cogging or torque ripple. Iron losses only"
    " heat: their braking torque is part of the joint's damping.",
    "Joints wear with distance and temperature, but nothing breaks; brakes, cable, windings and links do not age.",
    "Sensor cables have no interference, and no encoder error depends on the angle.",
    "Drives are ideal: the current follows at once, and their software has no limits, filters or faults of its own."
    " Commands reach a drive with a constant delay and are never lost.",
    "The supply voltage drops under load but never fails. Brakes are drives that hold. Currents are sampled once per"
    " control tick, both by the simulated windings and by the thermal observer: faster changes heat neither.",
    "A payload appears at the tool and vanishes, a push is a force on one link, the cable is a spring without mass:"
    " nothing is gripped, nobody is clamped, and the only obstacles are the robot, the scene in its model and, where it"
    " may be touched, a rigid goal.",
    "The computer meets every deadline: simulated time waits for it.",
    "The operator arms a latched robot again after a fixed delay, without looking for the cause.",
    "The report counts only what the simulation can show; no real robot was tested.",
)
NO_FAULTS = (
    "No sensor fails: readings are noisy, quantized, biased and drifting, packets are late or lost, but no faults were"
    " scheduled, neither of sensors nor of other parts."
)
FAULTS = (
    "Faults were injected on schedule, far more often than in normal operation: rates, availability and goals of this"
    " run apply to robots with injected faults."
)


def limitations(counts: Counts, evidence: Evidence, *, faults: bool) -> Iterator[str]:
    """Yield sentences on what a soak, with injected faults or without, does not show."""
    yield from _unknown(counts, evidence)
    yield FAULTS if faults else NO_FAULTS
    yield from NOT_SIMULATED


def _unknown(counts: Counts, evidence: Evidence) -> Iterator[str]:
    yield (
        f"Other robots: with {evidence.bad_draws} of {counts.robots} draws bad, up to"
        f" {100 * evidence.bad_draw_upper:.0f} % of all possible draws may be bad. More draws lower this bound, more"
        " hours do not."
    )
    yield f"Changes between two control ticks: the judge samples every {1e3 * counts.dt:g} ms."
    unjudged = [m.name for m in counts.monitors if np.isinf(counts.limits[counts.columns(m.name)]).any()]
    if unjudged:
        yield (
            f"Monitors without a known limit: {', '.join(unjudged)}. The policy file does not contain the statistics"
            " of its training data."
        )
    worst = {
        m.name: counts.worst[:, counts.columns(m.name)].max(initial=0.0) for m in counts.monitors if m.unit
    }
    unused = [name for name, load in worst.items() if load < LOAD_USED and name not in unjudged]
    if unused:
        yield (f"Behaviour near limits that no robot used to {100 * LOAD_USED:.0f} %: {', '.join(unused)}.")
    if counts.invalid.any():
        yield (
            f"{counts.invalid.sum()} ticks of the {np.count_nonzero(counts.invalid)} robots whose simulation"
            " diverged: they were not judged."
        )
