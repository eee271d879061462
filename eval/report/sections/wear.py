"""Section "wear": change of friction, backlash, encoders and motors from start to end."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from eval.report.schema.report_data import Wear, WornJoint
from eval.report.soak_result import SoakResult
from eval.statistics.numbers import median, number, series
from robots.arrays import Floats, Ints

DIGITS = 4


class Quantity(NamedTuple):
    """A quantity that wears; `factor` converts the plant's unit to `unit`."""

    name: str
    unit: str
    factor: float
    meaning: str


QUANTITIES = (
    Quantity("friction", "%", 100.0, "dry friction, in per cent of that of the new joint"),
    Quantity("backlash", "mrad", 1000.0, "backlash of the gear, from stop to stop"),
    Quantity("encoder error", "mrad", 1000.0, "absolute offset of a slipped encoder"),
    Quantity("torque constant", "%", 100.0, "torque per ampere, in per cent of that of the new motor"),
)
"""In the order of `SoakResult.worn`."""


def wear(result: SoakResult, at: Ints) -> Iterator[Wear]:
    """Yield every quantity, with curves at samples `at` (S,)."""
    names = result.counts.joints
    for k, quantity in enumerate(QUANTITIES):
        worn = quantity.factor * np.abs(result.worn[:, k])
        change = np.nan_to_num(np.abs(worn[-1] - worn[0]), nan=-1.0)
        robot, joint = np.unravel_index(change.argmax(), change.shape)
        yield Wear(
            name=quantity.name,
            unit=quantity.unit,
            meaning=quantity.meaning,
            median=series(median(worn[at].reshape(len(at), -1)), DIGITS),
            most_worn=series(worn[at, robot, joint], DIGITS),
            robot=int(robot),
            joint=names[joint],
            joints=tuple(
                _joint(name, worn[[0, -1], :, j], int(change[:, j].argmax())) for j, name in enumerate(names)
            ),
        )


def _joint(name: str, worn: Floats, robot: int) -> WornJoint:
    """Start and end of one joint, from (2, R)."""
    (start, end), (first, last) = median(worn), worn[:, robot]
    return WornJoint(
        joint=name,
        median=(number(start, DIGITS), number(end, DIGITS)),
        robot=robot,
        most_worn=(number(first, DIGITS), number(last, DIGITS)),
    )
