"""Limitations of the simulation, listed in every report."""

LIMITATIONS = (
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
    " nothing is gripped, nobody is clamped, and the only obstacles are the robot and the scene in its model.",
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
