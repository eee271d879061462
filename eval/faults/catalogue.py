"""Catalogue of the fault classes that are injected into simulated robots."""

from eval.faults.fault_class import FaultClass
from eval.faults.plant_faults import PLANT_FAULTS
from eval.faults.policy_faults import POLICY_FAULTS
from eval.faults.sensor_faults import sensor_faults
from robots.spec import RobotSpec

NOT_INJECTED = (
    "Tick overrun: simulated time waits for the computer; tests produce late ticks with a simulated clock.",
    "A start pose far away: robots start where they stand; tests check that arming is refused.",
    "A policy of wrong shape or digest: refused before any motion; tested with the policy file.",
    "Loss of log or disk: a soak records nothing; tests fill the recorder's disk.",
    "A diverged covariance: it has no cause of its own but follows from sensor failures, which are injected.",
    "Limits of joints, workspace and collisions: checked in every tick; runaway policies drive towards them.",
    "Two faults at once, and a fault while the robot answers another one.",
)
"""Faults that are not in the table of injections, and the reasons."""


def catalogue(spec: RobotSpec) -> tuple[FaultClass, ...]:
    """Return all fault classes of a robot, in the order of the report."""
    others = (fault.of_robot(spec) for fault in (*POLICY_FAULTS, *PLANT_FAULTS))
    return (*sensor_faults(spec), *others)
