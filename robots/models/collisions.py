"""Self-collision and collision with fixed surroundings, of copies of a robot in one Pinocchio model."""

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from robots.arrays import Bools, Floats
from robots.contacts import WORLD
from robots.errors import RobotError
from robots.models.blocks import strided_view
from robots.models.capsules import all_above, find_near
from robots.models.collision_pruning import Pairs
from robots.robot_file import SHAPES_MAX
from robots.spec import RobotSpec

PAIRS_MAX = 5000
"""Pairs of shapes that are checked for collision in every tick."""
SLACK = 1e-3
"""m, added to the height above which a capsule is not checked: far more than the rounding of an exact answer."""

ENDLESS = 1e6
"""m. A shape that reaches beyond this counts as endless, such as a plane."""


class Collisions:
    """Check of all copies of a robot for shapes nearer to each other than the margin.

    Pairs of capsules are compared by `find_near`, others by coal. A pair of a capsule and a fixed obstacle that is none
    (a table, a box, a wall) costs far more. While all capsules are above the highest point of their obstacle by more
    than the margin, those pairs are not checked; one capsule that is lower lets all of them be checked.
    """

    def __init__(
        self, model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs, copies: int, margin: float
    ) -> None:
        """Put the shapes side by side; those of the world come with each copy. `pairs` may meet, `margin` is in m."""
        shapes = list(geometry.geometryObjects)
        # The fixed shape of a pair comes first.
        pairs = [(b, a) if shapes[b].parentJoint == 0 else (a, b) for a, b in pairs]
        of_capsules, with_obstacle, others = _sorted(pairs, shapes)
        self._others = PairChecks(model, shapes, others, copies, margin)
        self._obstacles = PairChecks(model, shapes, with_obstacle, copies, margin)
        radius = [shape.geometry.radius if _is_capsule(shape) else 0.0 for shape in shapes]
        self._half = np.array([_half_length(shape) for shape in shapes])
        self._pairs = np.array(of_capsules, dtype=np.int64).reshape(-1, 2)
        self._reach = np.array([radius[a] + radius[b] + margin for a, b in of_capsules])
        self._clear_above = np.full(len(shapes), -np.inf)
        for a, b in with_obstacle:
            height = _top(shapes[a]) + margin + radius[b] + SLACK
            self._clear_above[b] = np.maximum(self._clear_above[b], height)
        self._copies, self._shapes = copies, _copied_shapes(model, shapes, copies)
        self._placements = self._shapes.createData()
        self._centre = strided_view([place.translation for place in self._placements.oMg])
        self._axis = strided_view([place.rotation for place in self._placements.oMg])[:, :, 2]

    def check(self, model: pin.Model, data: pin.Data) -> Bools:
        """Return (copies,) robots with shapes too near, at the placements in `data` of the `model` of all copies."""
        pin.updateGeometryPlacements(model, data, self._shapes, self._placements)
        hits = np.empty(self._copies, dtype=bool)
        find_near(self._centre, self._axis, self._half, self._pairs, self._reach, hits)
        if not all_above(self._centre[:, 2], self._axis[:, 2], self._half, self._clear_above):
            hits |= self._obstacles.check(model, data)
        return hits | self._others.check(model, data) if self._others.pairs else hits


class PairChecks:
    """Check of some pairs of shapes by coal, in all copies.

    Attributes:
        pairs: number of them in each copy.
    """

    def __init__(
        self, model: pin.Model, shapes: list[pin.GeometryObject], pairs: Pairs, copies: int, margin: float
    ) -> None:
        self._geometry, self._copies = _copied_shapes(model, shapes, copies), copies
        self.pairs = len(pairs)
        for first in range(0, copies * len(shapes), len(shapes)):
            for a, b in pairs:
                self._geometry.addCollisionPair(pin.CollisionPair(first + a, first + b))
        self._placements = self._geometry.createData()
        for request in self._placements.collisionRequests:
            request.security_margin = margin

    def check(self, model: pin.Model, data: pin.Data) -> Bools | bool:
        """Check these pairs, as `Collisions.check`; one False if all are clear."""
        pin.updateGeometryPlacements(model, data, self._geometry, self._placements)
        if not pin.computeCollisions(self._geometry, self._placements, False):
            return False
        hits = [result.isCollision() for result in self._placements.collisionResults]
        return np.asarray(np.reshape(hits, (self._copies, -1)).any(axis=1))


def _copied_shapes(model: pin.Model, shapes: list[pin.GeometryObject], copies: int) -> pin.GeometryModel:
    """Return the shapes of each copy of a robot in the `model` of all copies, without pairs."""
    geometry, joints = pin.GeometryModel(), model.njoints - 1
    for copy in range(copies):
        for shape in shapes:
            parent = shape.parentJoint and shape.parentJoint + copy * joints
            name = f"{copy}/{shape.name}"
            geometry.addGeometryObject(pin.GeometryObject(name, parent, shape.placement, shape.geometry))
    return geometry


def nearest_shapes(
    model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs, poses: Floats
) -> tuple[float, str, str]:
    """Return the least distance, m, between the shapes of a pair in any of the poses (P, n) rad, and their names.

    Infinite, and without names, where there is no pair; poses that are not finite are left out.
    """
    found = gaps(model, geometry, pairs, poses[np.isfinite(poses).all(axis=1)])
    if not found.size:
        return np.inf, "", ""
    closest = int(found.min(axis=0).argmin())
    a, b = (geometry.geometryObjects[shape].name for shape in pairs[closest])
    return float(found[:, closest].min()), a, b


def gaps(model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs, poses: Floats) -> Floats:
    """Return (P, pairs) m between the shapes of each pair in poses (P, n) rad."""
    shapes, found = geometry.copy(), np.empty((len(poses), len(pairs)))
    for a, b in pairs:
        shapes.addCollisionPair(pin.CollisionPair(a, b))
    data, placements = model.createData(), shapes.createData()
    for q, row in zip(poses, found, strict=True):
        pin.updateGeometryPlacements(model, data, shapes, placements, q)
        pin.computeDistances(shapes, placements)
        row[:] = [result.min_distance for result in placements.distanceResults]
    return found


def check_home(spec: RobotSpec, model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs) -> None:
    """Refuse (RobotError) a home pose with two shapes nearer than `margins.collision_m`."""
    gap, a, b = nearest_shapes(model, geometry, pairs, spec.joint_array("q_home")[None])
    if gap < (margin := spec.margins.collision_m or 0.0):
        raise RobotError(
            f"{spec.folder / 'robot.toml'}: joints: q_home: there {a!r} and {b!r} are {1e3 * gap:.3g} mm"
            f" apart, expected margins.collision_m, {1e3 * margin:.3g} mm: correct their capsules, or list their bodies"
            " as neighbours"
        )


def collision_pairs(
    model: pin.Model, geometry: pin.GeometryModel, neighbours: Sequence[tuple[str, str]] = ()
) -> Pairs:
    """Return pairs of shapes on links that are neither the same nor parent and child, nor on neighbouring bodies.

    Shapes outside of bodies are those of the body `WORLD`.

    Raises:
        ValueError: more shapes or pairs than a tick can check.
    """
    if geometry.ngeoms > SHAPES_MAX:
        raise ValueError(f"found {geometry.ngeoms} shapes, expected at most {SHAPES_MAX}")
    parents, near = list(model.parents), {frozenset(pair) for pair in neighbours}
    joints = [shape.parentJoint for shape in geometry.geometryObjects]
    frames = [shape.parentFrame for shape in geometry.geometryObjects]
    bodies = [model.frames[frame].name if frame else WORLD for frame in frames]
    pairs = [
        (a, b)
        for a in range(len(joints))
        for b in range(a + 1, len(joints))
        if joints[a] != joints[b]
        and parents[joints[a]] != joints[b]
        and parents[joints[b]] != joints[a]
        and frozenset((bodies[a], bodies[b])) not in near
    ]
    if len(pairs) > PAIRS_MAX:
        raise ValueError(f"found {len(pairs)} pairs of shapes, expected at most {PAIRS_MAX}")
    return pairs


def _sorted(pairs: Pairs, shapes: list[pin.GeometryObject]) -> tuple[Pairs, Pairs, Pairs]:
    """Return the pairs of capsules, those of an obstacle and a capsule, and all others."""
    of_capsules, with_obstacle, others = Pairs(), Pairs(), Pairs()
    for a, b in pairs:
        if not _is_capsule(shapes[b]):
            others.append((a, b))
        elif _is_capsule(shapes[a]):
            of_capsules.append((a, b))
        else:
            (with_obstacle if shapes[a].parentJoint == 0 else others).append((a, b))
    return of_capsules, with_obstacle, others


def _is_capsule(shape: pin.GeometryObject) -> bool:
    """Return True for a capsule, and for a sphere, which is one without length."""
    return isinstance(shape.geometry, coal.Capsule | coal.Sphere)


def _half_length(shape: pin.GeometryObject) -> float:
    return shape.geometry.halfLength if isinstance(shape.geometry, coal.Capsule) else 0.0


def _top(shape: pin.GeometryObject) -> float:
    """Return m, a height above which a fixed shape has no point; infinite for an endless one."""
    shape.geometry.computeLocalAABB()
    box = shape.geometry.aabb_local
    if np.abs((box.min_, box.max_)).max() > ENDLESS:
        return np.inf
    half = (box.max_ - box.min_) / 2
    return float(shape.placement.act(box.min_ + half)[2] + np.abs(shape.placement.rotation[2]) @ half)
