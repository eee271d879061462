"""Gains of drives."""

from typing import NamedTuple

import numpy as np

from robots.arrays import Floats


class Gains(NamedTuple):
    """Stiffness and damping of each drive: kp in N·m/rad, kd in N·m·s/rad, (n,) each, both at the joint."""

    kp: Floats
    kd: Floats

    @property
    def stiff(self) -> bool:
        """True if every drive holds its angle."""
        return bool((np.asarray(self.kp) > 0).all())
