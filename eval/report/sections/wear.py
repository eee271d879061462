"""How the robots of the end differ from those of the start."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from eval.report.schema.numbers import median, number, series
from eval.report.schema.report_data import SoakResult, Wear, WornJoint
from robots.arrays import Floats, Ints

DIGITS = 4


class Quantity(NamedTuple):
    """What wears, and how many of its `unit` are one of the plant's."""

    name: str
    unit: str
    per: float
    meaning: str


QUANTITIES = (
    Quantity("friction", "%", 100.0, "dry friction, in per cent of the new joint's"),
    Quantity("backlash", "mrad", 1000.0, "play of the gear, from stop to stop"),
    Quantity("encoder error", "mrad", 1000.0, "by how much a slipping encoder is off, either way"),
    Quantity("torque constant", "%", 100.0, "torque per ampere, in per cent of the new motor's"),
)
"""In the order of `SoakResult.worn`."""


def wear(result: SoakResult, at: Ints) -> Iterator[Wear]:
    """Every quantity, its curves at samples `at` (S,)."""
    names = result.counts.joints
    for k, quantity in enumerate(QUANTITIES):
        worn = quantity.per * np.abs(result.worn[:, k])
        moved = np.nan_to_num(np.abs(worn[-1] - worn[0]), nan=-1.0)
        robot, joint = np.unravel_index(moved.argmax(), moved.shape)
        yield Wear(
            name=quantity.name,
            unit=quantity.unit,
            meaning=quantity.meaning,
            median=series(median(worn[at].reshape(len(at), -1)), DIGITS),
            most_worn=series(worn[at, robot, joint], DIGITS),
            robot=int(robot),
            joint=names[joint],
            joints=tuple(
                _joint(name, worn[[0, -1], :, j], int(moved[:, j].argmax())) for j, name in enumerate(names)
            ),
        )


def _joint(name: str, worn: Floats, robot: int) -> WornJoint:
    """Of (2, R) at the start and at the end."""
    (start, end), (first, last) = median(worn), worn[:, robot]
    return WornJoint(
        joint=name,
        median=(number(start, DIGITS), number(end, DIGITS)),
        robot=robot,
        most_worn=(number(first, DIGITS), number(last, DIGITS)),
    )
