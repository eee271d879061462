"""Levers of joints: how far from a joint what it carries can be."""

import numpy as np
import pinocchio as pin

from robots.arrays import Floats
from robots.models.nominal_model import load_pinocchio
from robots.models.pinocchio_model import tool_frame
from robots.spec import RobotSpec


def joint_levers(spec: RobotSpec) -> Floats:
    """Return (n,) m, an upper bound of the distance of tool and shapes from each joint, in any pose.

    Raises:
        RobotError: as `load_pinocchio`.
    """
    model, geometry = load_pinocchio(spec)
    ends = [
        (shape.parentJoint, shape_length(shape)) for shape in geometry.geometryObjects if shape.parentJoint
    ]
    levers = tool_levers(spec, model)
    for joint, length in ends:
        np.maximum(levers, levers_of_point(model, joint, length), out=levers)
    return levers


def tool_levers(spec: RobotSpec, model: pin.Model) -> Floats:
    """Return (n,) m, as `joint_levers`, of the tool alone; 0 without one."""
    levers = np.zeros(spec.n)
    for frame in tool_frame(spec, model):
        tool = model.frames[frame]
        levers += levers_of_point(model, tool.parentJoint, float(np.linalg.norm(tool.placement.translation)))
    return levers


def shape_length(shape: pin.GeometryObject) -> float:
    """Return m, the greatest distance of a shape's points from the joint that carries it."""
    shape.geometry.computeLocalAABB()
    centre = shape.placement.act(shape.geometry.aabb_center)
    return float(np.linalg.norm(centre)) + float(shape.geometry.aabb_radius)


def levers_of_point(model: pin.Model, joint: int, length: float) -> Floats:
    """Return (n,) m, 0 for joints that do not carry it, of a point `length` m from the joint that does.

    No pose takes the point farther from a joint than all the links after it, end to end.
    """
    levers = np.zeros(model.njoints - 1)
    while joint:
        levers[joint - 1] = length
        length += float(np.linalg.norm(model.jointPlacements[joint].translation))
        joint = model.parents[joint]
    return levers
