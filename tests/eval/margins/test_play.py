"""A push throws a worn wrist through the play of its gear while the wrist turns as fast as a policy can make it."""

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("mujoco")

from deploy.simulation import simulate
from eval.attack.policy_graph import attack_contract
from robots.distributions import load_distributions
from robots.draws import draw
from robots.models.nominal_model import load_pinocchio
from robots.motors.control_mode import ControlMode
from robots.randomness import robot_seed
from support.arm6 import SPEC

ARMED, MOVES, LIVES = 40, 420, 2.0
"""Ticks after which the arm gets power, and has arrived where it moves from; lives that its joints have used up."""
ALONE = {"push.every_s": 1e9, "payload.carried_s": 0.1, "payload.free_s": 1e5}
"""Without payload, and pushed by the test."""


def direction(q, joint, link):
    """(3,) unit vector of a force on the middle of a link that turns a joint most, in its positive sense."""
    model, _ = load_pinocchio(SPEC)
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    jacobian = pin.getJointJacobian(model, data, link + 1, pin.LOCAL_WORLD_ALIGNED)[:, joint]
    middle = data.oMi[link + 1].rotation @ model.inertias[link + 1].lever
    found = jacobian[:3] + np.cross(jacobian[3:], middle)
    return found / np.linalg.norm(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "joint", "link", "tick", "pose"),
    [
        (304, 4, 5, 572, (-0.540, -1.721, 1.055, -1.105, -0.608, 1.565)),
        (693, 3, 4, 476, (-0.409, -1.975, 1.854, -2.408, -0.600, 0.430)),
    ],
)
def test_a_push_through_worn_play_keeps_the_limit_of_speed(robot, joint, link, tick, pose):
    """Robots and poses of an attack, which came to 1.061 and 1.066 where 0.83 of the limit was planned."""
    seeds = [robot_seed(2, robot)]
    drawn = draw(load_distributions(SPEC), SPEC, seeds).replaced(ALONE)
    runtime, arm = simulate(SPEC, attack_contract(SPEC, ControlMode.POSITION), seeds, draw=drawn)
    arm.plant.wear.life[:] = LIVES
    arm.plant.wear.apply()
    pushes = arm.plant.disturbances["pushes"]
    first, last = np.tile(pose, (2, 1))
    last[joint], first[joint] = (end[joint] for end in SPEC.pose_range)
    fastest = np.zeros(SPEC.n)
    for k in range(tick + 20):
        if k == ARMED:
            runtime.arm(np.ones(1, dtype=bool))
        runtime.sense()
        runtime.act((first if k < MOVES else last)[None])
        q, qd = arm.truth().q[0], arm.truth().qd[0]
        fastest = np.maximum(fastest, np.abs(qd))
        if k == tick:
            before = fastest.copy()
            force = drawn["push.force_n"][0] * -direction(q, joint, link)
            pushes._applied[0, pushes._bodies[len(pushes._bodies) - SPEC.n + link], :3] = force
    limit = SPEC.joint_array("qd_max")[joint]
    assert before[joint] < 0.85 * limit
    assert 0.95 * limit < fastest[joint] <= limit
