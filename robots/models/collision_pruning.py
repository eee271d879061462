"""Pruning of collision pairs: those that cannot meet inside the working ranges need no check on every tick.

A proof, not a sample: a box of joint angles is clear if the distance at its middle is more than any pose of the box can
close. Boxes that are not clear are halved.
"""

from collections import deque

import numpy as np
import pinocchio as pin

from robots.arrays import Floats
from robots.models.levers import levers_of_point, shape_length
from robots.spec import RobotSpec

Pairs = list[tuple[int, int]]

BOXES_MAX = 2000
"""Boxes examined for a pair, the largest first; a pair that needs more is kept."""
HOPELESS = 500
"""Boxes after which a pair is kept if none was clear: so many joints between its shapes take too many boxes."""
PLACES_MAX = 1 << 21
"""Places of shapes computed for all pairs together, some seconds; pairs that are left are kept."""


_KEPT: dict[tuple[str, tuple[tuple[int, int], ...]], Pairs] = {}


def pairs_to_check(spec: RobotSpec, model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs) -> Pairs:
    """Return `prune_pairs` of the models of `load_pinocchio`, computed once in a process: it takes 0.06 s."""
    key = spec.digest, tuple(pairs)
    if key not in _KEPT:
        _KEPT[key] = prune_pairs(spec, model, geometry, pairs)
    return _KEPT[key]


def prune_pairs(spec: RobotSpec, model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs) -> Pairs:
    """Return the pairs that are not proven to stay farther apart than the collision margin in the working ranges.

    Model and geometry are those of `load_pinocchio`, all joints hinges, without pairs of their own.
    """
    alone = geometry.copy()
    for a, b in pairs:
        alone.addCollisionPair(pin.CollisionPair(a, b))
    proof = _Proof(spec, model, alone)
    return [pair for number, pair in enumerate(pairs) if not proof.clear(number)]


class _Proof:
    """Search for a proof that a pair of shapes cannot meet."""

    def __init__(self, spec: RobotSpec, model: pin.Model, geometry: pin.GeometryModel) -> None:
        self._model, self._data = model, model.createData()
        self._geometry, self._placements = geometry, geometry.createData()
        self._margin = spec.margins.collision_m or 0.0
        self._range, self._places_left = spec.pose_range, PLACES_MAX

    def clear(self, number: int) -> bool:
        """Return True if every box of joint angles was proven clear for a pair."""
        reach, boxes, cleared = self._reach(number), deque([self._range]), 0
        for examined in range(BOXES_MAX):
            if not boxes:
                return True
            if (examined == HOPELESS and not cleared) or self._places_left <= 0:
                return False
            least, most = boxes.popleft()
            distance = self._distance(number, (least + most) / 2) - self._margin
            if distance <= 0:
                return False
            closing = reach * (most - least) / 2
            if distance > closing.sum():
                cleared += 1
            else:
                boxes.extend(_halves(least, most, int(closing.argmax())))
        return False

    def _distance(self, number: int, q: Floats) -> float:
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._placements, q)
        self._places_left -= self._geometry.ngeoms
        return float(pin.computeDistance(self._geometry, self._placements, number).min_distance)

    def _reach(self, number: int) -> Floats:
        """Return (n,) m/rad by which any points of the two shapes can approach each other."""
        pair = self._geometry.collisionPairs[number]
        a, b = (self._geometry.geometryObjects[shape] for shape in (pair.first, pair.second))
        return _reach(self._model, a, b.parentJoint) + _reach(self._model, b, a.parentJoint)


def _reach(model: pin.Model, shape: pin.GeometryObject, other: int) -> Floats:
    """Return (n,) m/rad, the speed bound of the shape's points for each hinge that carries it and not joint `other`.

    The axis passes through the hinge's origin. A shape of the world is carried by none: a plane has no end.
    """
    if shape.parentJoint == 0:
        return np.zeros(model.njoints - 1)
    reach = levers_of_point(model, shape.parentJoint, shape_length(shape))
    reach[[joint - 1 for joint in model.supports[other] if joint]] = 0.0
    return reach


def _halves(least: Floats, most: Floats, joint: int) -> list[tuple[Floats, Floats]]:
    below, above = most.copy(), least.copy()
    below[joint] = above[joint] = (least[joint] + most[joint]) / 2
    return [(least, below), (above, most)]
