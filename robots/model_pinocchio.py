"""Pinocchio's model of a robot, and many robots in one model.

`Arms` puts up to `BLOCK` copies of the robot side by side in one Pinocchio model, so one C++ call serves a whole
block: 0.7 µs of inverse dynamics per six-joint robot against 4 µs for a call each. Wider models lose: the memory of
`pinocchio.Data` grows with the cube of the joints.
"""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from robots.errors import RobotError
from robots.spec import RobotSpec

BLOCK = 16

Floats = NDArray[np.float64]


def load_pinocchio(spec: RobotSpec) -> tuple[pin.Model, pin.GeometryModel]:
    """Build model and collision geometry from model.xml, joints as robot.toml orders them.

    Raises:
        RobotError: Pinocchio cannot read the file, or its joints are not those of robot.toml.
    """
    path = str(spec.model_path)
    try:
        model = pin.buildModelFromMJCF(path)
        geometry = pin.buildGeomFromMJCF(model, path, pin.GeometryType.COLLISION)
    except (ValueError, RuntimeError) as e:
        raise RobotError(f"{path}: Pinocchio cannot read it: {e!s:.300}") from e
    found = tuple(model.names[1:])
    if found != spec.joint_names:
        raise RobotError(f"{path}: joints are {found}; robot.toml lists {spec.joint_names}")
    if not model.existFrame(spec.tool):
        raise RobotError(f"{path}: no site named {spec.tool!r}, which robot.toml calls the tool")
    return model, geometry


def collision_pairs(model: pin.Model, geometry: pin.GeometryModel) -> list[tuple[int, int]]:
    """Pairs of geometries on links that are neither the same nor parent and child."""
    parents = list(model.parents)
    joints = [shape.parentJoint for shape in geometry.geometryObjects]
    return [
        (a, b)
        for a in range(len(joints))
        for b in range(a + 1, len(joints))
        if joints[a] != joints[b]
        and parents[joints[a]] != joints[b]
        and parents[joints[b]] != joints[a]
    ]
