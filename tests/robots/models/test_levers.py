"""Levers of joints, against places in random poses."""

import numpy as np
import pinocchio as pin
import pytest

from robots.models.levers import joint_levers
from robots.models.nominal_model import load_pinocchio
from robots.spec import load_robot


@pytest.mark.parametrize("name", ["arm6", "planar3", "quadruped"])
def test_no_pose_takes_tool_or_shapes_farther(name):
    """They come within a tenth of it in some pose, but for capsules, whose middle is what is looked at."""
    spec = load_robot(name)
    model, geometry = load_pinocchio(spec)
    data, placements = model.createData(), geometry.createData()
    rng, farthest = np.random.default_rng(0), np.zeros(spec.n)
    tools = [model.getFrameId(spec.tool)] if spec.tool else []
    for q in rng.uniform(-np.pi, np.pi, (2000, spec.n)):
        pin.framesForwardKinematics(model, data, q)
        pin.updateGeometryPlacements(model, data, geometry, placements)
        places = [(model.frames[tool].parentJoint, data.oMf[tool].translation) for tool in tools]
        places += [
            (shape.parentJoint, place.translation)
            for shape, place in zip(geometry.geometryObjects, placements.oMg, strict=True)
        ]
        for joint, place in places:
            for each in list(model.supports[joint])[1:]:
                away = np.linalg.norm(place - data.oMi[each].translation)
                farthest[each - 1] = max(farthest[each - 1], away)
    levers = joint_levers(spec)
    assert (farthest <= levers + 1e-12).all()
    assert (levers <= 1.1 * farthest + 0.1).all()
