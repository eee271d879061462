import numpy as np

from eval.faults.catalogue import catalogue
from eval.faults.fault_class import Injection
from eval.faults.schedule import Schedule, with_parts
from support.arm6 import SPEC

CLASSES, N, DT = catalogue(SPEC, SPEC.sensors), SPEC.n, SPEC.dt


def named(name):
    return next(each for each in CLASSES if each.name == name)


def one_each(faults, begins, *, lasts=None, classes=CLASSES):
    """A schedule that gives each robot one fault: (class, channel), or None for none."""
    injections = [
        Injection(
            robot=robot,
            slot=0,
            fault=fault[0],
            channel=fault[1],
            begins=begins,
            ends=begins + (round(fault[0].lasts_s / DT) if lasts is None else lasts),
            slot_end=begins + 2_000,
        )
        for robot, fault in enumerate(faults)
        if fault is not None
    ]
    rng = np.random.default_rng(0)
    whole = [with_parts(each, rng, DT) for each in injections]
    return Schedule(classes, len(faults), whole)
