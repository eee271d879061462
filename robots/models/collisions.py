"""Collisions of robots that stand side by side in one Pinocchio model, each with itself and its surroundings."""

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from robots.arrays import Bools, Floats
from robots.errors import RobotError
from robots.models.blocks import lined_up
from robots.models.clearance import Pairs
from robots.spec import RobotSpec

SLACK = 1e-3
"""m. A capsule must be this much higher than need be to be spared: far more than the rounding of an exact answer."""

FAR = 1e6
"""m. What reaches beyond this has no end."""


class Collisions:
    """Which copies of a robot have shapes nearer to each other than the margin.

    A capsule and a table (a box, a wall: whatever is fixed and no capsule) cost three times two capsules, and mostly
    nobody need ask: what is higher than the table's highest point by more than the margin does not touch it. One robot
    that is lower makes all copies ask.
    """

    def __init__(
        self, model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs, copies: int, margin: float
    ) -> None:
        """Put the shapes side by side.

        Args:
            model, geometry: one robot; the shapes of the world come with each copy.
            pairs: indices of shapes that may meet.
            copies: how many robots.
            margin: m.
        """
        shapes = list(geometry.geometryObjects)
        # What is fixed comes first.
        pairs = [(b, a) if shapes[b].parentJoint == 0 else (a, b) for a, b in pairs]
        tables = [(a, b) for a, b in pairs if _stands(shapes[a]) and _capsule(shapes[b])]
        others = [pair for pair in pairs if pair not in tables]
        self._others = _Shapes(model, shapes, others, copies, margin)
        self._tables = _Shapes(model, shapes, tables, copies, margin)
        spared_above = np.full(len(shapes), -np.inf)
        for a, b in tables:
            height = _top(shapes[a]) + margin + shapes[b].geometry.radius + SLACK
            spared_above[b] = np.maximum(spared_above[b], height)
        half = [shape.geometry.halfLength if _capsule(shape) else 0.0 for shape in shapes]
        self._spared_above, self._half = np.tile(spared_above, copies), np.tile(half, copies)
        self._lowest, self._above = np.zeros_like(self._half), np.zeros(self._half.shape, dtype=bool)
        places = self._others.places.oMg
        self._height = lined_up([place.translation for place in places])[:, 2]
        self._steepness = lined_up([place.rotation for place in places])[:, 2, 2]

    def look(self, model: pin.Model, data: pin.Data) -> Bools | bool:
        """(copies,) whether shapes are too near where `data` of all the copies' `model` has them.

        One answer if none are.
        """
        hits = self._others.look(model, data)
        np.abs(self._steepness, out=self._lowest)
        np.multiply(self._lowest, self._half, out=self._lowest)
        np.subtract(self._height, self._lowest, out=self._lowest)
        np.greater(self._lowest, self._spared_above, out=self._above)
        if 0 not in self._above.tobytes():
            return hits
        return hits | self._tables.look(model, data)


class _Shapes:
    """The shapes of all copies, and some pairs of them; `places` is where they were at the last look."""

    def __init__(
        self, model: pin.Model, shapes: list[pin.GeometryObject], pairs: Pairs, copies: int, margin: float
    ) -> None:
        self._geometry, self._copies = pin.GeometryModel(), copies
        joints = model.njoints - 1
        for copy in range(copies):
            for shape in shapes:
                parent = shape.parentJoint and shape.parentJoint + copy * joints
                self._geometry.addGeometryObject(
                    pin.GeometryObject(f"{copy}/{shape.name}", parent, shape.placement, shape.geometry)
                )
            for a, b in pairs:
                offset = copy * len(shapes)
                self._geometry.addCollisionPair(pin.CollisionPair(a + offset, b + offset))
        self.places = self._geometry.createData()
        for request in self.places.collisionRequests:
            request.security_margin = margin

    def look(self, model: pin.Model, data: pin.Data) -> Bools | bool:
        """As `Collisions.look`, for these pairs; ordered by copy, as the pairs are."""
        pin.updateGeometryPlacements(model, data, self._geometry, self.places)
        if not pin.computeCollisions(self._geometry, self.places, False):
            return False
        hits = [result.isCollision() for result in self.places.collisionResults]
        return np.asarray(np.reshape(hits, (self._copies, -1)).any(axis=1))


def nearest(
    model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs, poses: Floats
) -> tuple[float, str, str]:
    """M between the two shapes that come nearest to each other in any of some poses (P, n) rad, and their names.

    Infinitely far, and nameless, where nothing can meet; a pose that is no numbers is left out.
    """
    shapes, found = geometry.copy(), [(np.inf, "", "")]
    for a, b in pairs:
        shapes.addCollisionPair(pin.CollisionPair(a, b))
    data, places = model.createData(), shapes.createData()
    for q in poses[np.isfinite(poses).all(axis=1)] if pairs else ():
        pin.updateGeometryPlacements(model, data, shapes, places, q)
        closest = pin.computeDistances(shapes, places)
        a, b = (shapes.geometryObjects[shape].name for shape in pairs[closest])
        found.append((places.distanceResults[closest].min_distance, a, b))
    return min(found)


def check_home(spec: RobotSpec, model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs) -> None:
    """Check that shapes keep `margins.collision_m` apart in the home pose.

    Raises:
        RobotError: naming the two that are nearest, if they are too near.
    """
    gap, a, b = nearest(model, geometry, pairs, spec.joint_array("q_home")[None])
    if gap < (margin := spec.margins.collision_m or 0.0):
        raise RobotError(
            f"{spec.folder / 'robot.toml'}: joints: q_home: there {a!r} and {b!r} are {1e3 * gap:.3g} mm"
            f" apart, expected margins.collision_m, {1e3 * margin:.3g} mm: mend their capsules, or let their bodies be"
            " neighbours"
        )


def collision_pairs(
    model: pin.Model, geometry: pin.GeometryModel, neighbours: Sequence[tuple[str, str]] = ()
) -> Pairs:
    """Pairs of shapes on links that are neither the same nor parent and child, nor on bodies that are neighbours."""
    parents, near = list(model.parents), {frozenset(pair) for pair in neighbours}
    joints = [shape.parentJoint for shape in geometry.geometryObjects]
    bodies = [model.frames[shape.parentFrame].name for shape in geometry.geometryObjects]
    return [
        (a, b)
        for a in range(len(joints))
        for b in range(a + 1, len(joints))
        if joints[a] != joints[b]
        and parents[joints[a]] != joints[b]
        and parents[joints[b]] != joints[a]
        and frozenset((bodies[a], bodies[b])) not in near
    ]


def _capsule(shape: pin.GeometryObject) -> bool:
    return isinstance(shape.geometry, coal.Capsule)


def _stands(shape: pin.GeometryObject) -> bool:
    """Whether a shape is fixed to the world and no capsule: a pair of capsules is quick as it is."""
    return shape.parentJoint == 0 and not _capsule(shape)


def _top(shape: pin.GeometryObject) -> float:
    """m, a height above which a fixed shape has no point; infinite for one that has no end, as a plane."""
    shape.geometry.computeLocalAABB()
    box = shape.geometry.aabb_local
    if np.abs((box.min_, box.max_)).max() > FAR:
        return np.inf
    half = (box.max_ - box.min_) / 2
    return float(shape.placement.act(box.min_ + half)[2] + np.abs(shape.placement.rotation[2]) @ half)
