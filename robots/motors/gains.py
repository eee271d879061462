"""Gains of position-controlled drives."""

from typing import NamedTuple

import numpy as np

from robots.arrays import Floats


class Gains(NamedTuple):
    """Proportional and derivative gain of each drive: (n,) kp in N·m/rad, kd in N·m·s/rad, both at the joint."""

    kp: Floats
    kd: Floats


def same_gains(one: Gains | None, other: Gains | None) -> bool:
    """Return True if two sets of gains, or their absence, are equal."""
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other)
