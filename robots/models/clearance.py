"""Which pairs of shapes can meet inside the working ranges: the others need no check on every tick.

No sampling: a box of joint angles is clear if the distance at its middle is more than any pose of the box can close.
"""

from collections import deque

import numpy as np
import pinocchio as pin

from robots.arrays import Floats
from robots.spec import RobotSpec

Pairs = list[tuple[int, int]]

BOXES = 2000
"""Boxes looked at for a pair, the largest first; one that needs more stays a pair to check."""
HOPELESS = 500
"""Boxes of which none is clear: a pair with so many joints between its shapes does not come to an end."""


def can_meet(spec: RobotSpec, model: pin.Model, geometry: pin.GeometryModel, pairs: Pairs) -> Pairs:
    """Those of the pairs that are not proven to stay farther apart than the collision margin.

    Args:
        spec: the robot, of which working ranges and margin count.
        model, geometry: as `load_pinocchio`, all joints hinges; without pairs of their own.
        pairs: indices of shapes.
    """
    data, alone = model.createData(), geometry.copy()
    for a, b in pairs:
        alone.addCollisionPair(pin.CollisionPair(a, b))
    places, margin = alone.createData(), spec.margins.collision_m or 0.0
    low, high = spec.joint_array("q_min"), spec.joint_array("q_max")

    def clear(number: int) -> bool:
        a, b = (geometry.geometryObjects[shape] for shape in pairs[number])
        reach = _reach(model, a, b.parentJoint) + _reach(model, b, a.parentJoint)
        boxes, apart = deque([(low, high)]), 0
        for looked in range(BOXES):
            if not boxes:
                return True
            if looked == HOPELESS and not apart:
                return False
            least, most = boxes.popleft()
            pin.updateGeometryPlacements(model, data, alone, places, (least + most) / 2)
            distance = pin.computeDistance(alone, places, number).min_distance - margin
            if distance <= 0:
                return False
            closing = reach * (most - least) / 2
            if distance > closing.sum():
                apart += 1
            else:
                boxes.extend(_halves(least, most, int(closing.argmax())))
        return False

    return [pair for number, pair in enumerate(pairs) if not clear(number)]


def _reach(model: pin.Model, shape: pin.GeometryObject, other: int) -> Floats:
    """(n,) m/rad, how fast any point of a shape can move for each hinge that carries it and not joint `other`.

    The axis passes through the hinge's origin, and no point of the shape is farther from there than all the links
    after it and the shape itself, end to end.
    """
    reach = np.zeros(model.njoints - 1)
    joints = [j for j in model.supports[shape.parentJoint] if j not in model.supports[other]]
    if not joints:  # fixed to the world, where a plane has no end
        return reach
    shape.geometry.computeLocalAABB()
    centre, radius = shape.placement.act(shape.geometry.aabb_center), shape.geometry.aabb_radius
    length = float(np.linalg.norm(centre)) + radius
    for joint in reversed(joints):
        reach[joint - 1] = length
        length += float(np.linalg.norm(model.jointPlacements[joint].translation))
    return reach


def _halves(least: Floats, most: Floats, joint: int) -> list[tuple[Floats, Floats]]:
    below, above = most.copy(), least.copy()
    below[joint] = above[joint] = (least[joint] + most[joint]) / 2
    return [(least, below), (above, most)]
