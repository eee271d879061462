"""Pushes that throw links of worn arms through the play of their gears."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("mujoco")

from deploy.simulation import simulate
from eval.attack.policy_graph import attack_contract
from robots.arrays import Floats
from robots.distributions import load_distributions
from robots.draws import draw
from robots.models.nominal_model import load_pinocchio, torque_max
from robots.motors.control_mode import ControlMode
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.arm6 import SPEC, copy_of_arm

ARMED, MOVES, LIVES = 40, 420, 2.0
"""Ticks after which the arm gets power, and has arrived where it moves from; lives that its joints have used up."""
LOOKED_AT = 20
"""Ticks from the beginning of the push."""
WITHOUT_PAYLOAD = {"push.every_s": 1e9, "payload.carried_s": 0.1, "payload.free_s": 1e5}
WITH_PAYLOAD = {"push.every_s": 1e9, "payload.carried_s": 1e5, "payload.free_s": 0.1}
"""Pushed by the test alone."""


def direction(q, joint, link):
    """(3,) unit vector of a force on the middle of a link that turns a joint most, in its positive sense."""
    model, _ = load_pinocchio(SPEC)
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    jacobian = pin.getJointJacobian(model, data, link + 1, pin.LOCAL_WORLD_ALIGNED)[:, joint]
    middle = data.oMi[link + 1].rotation @ model.inertias[link + 1].lever
    found = jacobian[:3] + np.cross(jacobian[3:], middle)
    return found / np.linalg.norm(found)


class Thrown(NamedTuple):
    """Largest speed, rad/s, and torque, N·m, (n,) each, before and from the push."""

    speed: Floats
    speed_before: Floats
    torque: Floats


def throw(spec, drawn, poses, moves, tick, push):
    """Move from one pose to another from tick `moves` on, and push: (link, joint, sense) along that joint's motion."""
    seeds, (link, joint, sense) = [robot_seed(0, 0)], push
    runtime, arm = simulate(spec, attack_contract(spec, ControlMode.POSITION), seeds, draw=drawn)
    arm.plant.wear.life[:] = LIVES
    arm.plant.wear.apply()
    pushes = arm.plant.disturbances["pushes"]
    speed, torque = np.zeros((2, spec.n))
    for k in range(tick + LOOKED_AT):
        if k == ARMED:
            runtime.arm(np.ones(1, dtype=bool))
        runtime.sense()
        runtime.act(np.array(poses[k >= moves])[None])
        truth = arm.truth()
        speed, torque = np.maximum(speed, np.abs(truth.qd[0])), np.maximum(torque, np.abs(truth.tau[0]))
        if k == tick:
            before, torque = speed, np.zeros(spec.n)
            force = drawn["push.force_n"][0] * sense * direction(truth.q[0], joint, link)
            pushes._applied[0, pushes._bodies[len(pushes._bodies) - spec.n + link], :3] = force
    return Thrown(speed, before, torque)


def robot_of(seed, robot, disturbed):
    """Draw one robot of a seed."""
    return draw(load_distributions(SPEC), SPEC, [robot_seed(seed, robot)]).replaced(disturbed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "joint", "link", "tick", "pose"),
    [
        (304, 4, 5, 578, (-0.540, -1.721, 1.055, -1.105, -0.608, 1.565)),
        (693, 3, 4, 478, (-0.409, -1.975, 1.854, -2.408, -0.600, 0.430)),
    ],
)
def test_a_push_through_worn_play_keeps_the_limit_of_speed(robot, joint, link, tick, pose):
    """Robots and poses of an attack, which came to 1.061 and 1.066 where 0.83 of the limit was planned."""
    first, last = np.tile(pose, (2, 1))
    last[joint], first[joint] = (end[joint] for end in SPEC.pose_range)
    drawn = robot_of(2, robot, WITHOUT_PAYLOAD)
    found = throw(SPEC, drawn, (first, last), MOVES, tick, (link, joint, -1.0))
    limit = SPEC.joint_array("qd_max")[joint]
    assert found.speed_before[joint] < 0.8 * limit
    assert 0.9 * limit < found.speed[joint] <= limit


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "low", "high"), [("0.064", 0.7, 0.9), ("0.12", 0.99, np.inf)])
def test_a_blow_in_the_play_takes_all_of_the_torque_only_with_more_damping(tmp_path, damping, low, high):
    """Robot and pose of an attack: the stretched arm swings its pan, and the push begins as the planner brakes."""
    spec = load_robot(copy_of_arm(tmp_path, xml=[("0.064 0 0 48", f"{damping} 0 0 48")]))
    first, last = np.tile((0.0, -0.4973, 0.5101, -1.6896, -0.9839, 0.0), (2, 1))
    first[0], last[0] = -0.9, 0.9
    found = throw(spec, robot_of(3, 6531, WITH_PAYLOAD), (first, last), 300, 467, (5, 0, 1.0))
    assert low < found.torque[0] / torque_max(spec)[0] < high
