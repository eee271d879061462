"""Mistakes of whole drives: commands, encoder and current together exchanged with another joint's, or reversed.

Software and robot then agree on every motion, and only gravity tells: the motors hold another torque than the model
says of the pose that the software believes in.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from deploy.commissioning.bounds import Bounds
from robots.arrays import Floats, Ints
from robots.spec import RobotSpec


class WholeDrive(NamedTuple):
    """One such mistake.

    Attributes:
        joints: one that is reversed, or two that are exchanged.
        low, high: (n,) N·m, least and largest torque against gravity that would be measured.
    """

    joints: tuple[int, ...]
    low: Floats
    high: Floats

    def fits(self, measured: Floats, error: Floats) -> bool:
        """Return True if torques (n,) N·m may be as measured, within errors (n,) N·m; NaN: not measured."""
        inside = (measured >= self.low - error) & (measured <= self.high + error)
        return bool((inside | np.isnan(measured)).all())

    def text(self, names: Sequence[str]) -> str:
        """Return the mistake in words, with the `names` of all joints."""
        if len(self.joints) == 1:
            return f"drive and encoder of {names[self.joints[0]]} both reversed"
        return (
            f"drives of {' and '.join(names[joint] for joint in self.joints)} exchanged, with their encoders"
        )


def whole_drive_mistakes(spec: RobotSpec, bounds: Bounds, q: Floats) -> Iterator[WholeDrive]:
    """Yield every single mistake at the joint angles (n,) rad that the software reads.

    One under which the robot would stand outside its working range is left out.
    """
    low, high = spec.joint_array("q_min"), spec.joint_array("q_max")
    for joint in range(spec.n):
        sign = np.where(np.arange(spec.n) == joint, -1.0, 1.0)
        if low[joint] <= -q[joint] <= high[joint]:
            yield _reversed(bounds, q, joint, sign)
    for pair in combinations(range(spec.n), 2):
        order = np.arange(spec.n)
        order[list(pair)] = pair[::-1]
        if ((low <= q[order]) & (q[order] <= high)).all():
            yield _exchanged(bounds, q, pair, order)


def _reversed(bounds: Bounds, q: Floats, joint: int, sign: Floats) -> WholeDrive:
    ends = [sign * end for end in bounds.gravity_range(sign * q)]
    return WholeDrive((joint,), np.minimum(*ends), np.maximum(*ends))


def _exchanged(bounds: Bounds, q: Floats, pair: tuple[int, ...], order: Ints) -> WholeDrive:
    constants = bounds.constant / bounds.constant[order]
    low, high = (constants * end[order] for end in bounds.gravity_range(q[order]))
    return WholeDrive(pair, low, high)
