"""Pushes that throw links of worn arms through the play of their gears."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("mujoco")

from deploy.simulation import simulate
from eval.attack.policy_graph import attack_contract
from eval.attack.trained_gains import TrainedGains
from eval.mutants.guard_removal import skip_stop_checks
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


def direction(q, motion, link, offset):
    """(3,) unit vector of the motion of a link's centre of mass, `offset` m from the model's, at joint speeds (n,)."""
    model, _ = load_pinocchio(SPEC)
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    jacobian = pin.getJointJacobian(model, data, link + 1, pin.LOCAL_WORLD_ALIGNED) @ motion
    middle = data.oMi[link + 1].rotation @ (model.inertias[link + 1].lever + offset)
    found = jacobian[:3] + np.cross(jacobian[3:], middle)
    return found / np.linalg.norm(found)


def of_joint(joint, sense):
    """(n,) speeds of one joint."""
    return sense * np.eye(SPEC.n)[joint]


FORMER = [
    ("\nspeed = 0.68", "\nspeed = 0.70"),
    ("tau = 0.46", "tau = 0.50"),
    ("qdd_max = 9.2", "qdd_max = 10.3"),
    ("qdd_max = 1.8", "qdd_max = 2.6"),
    ("qdd_max = 4.5", "qdd_max = 6.0"),
]
"""Margins of speed and torque, and accelerations of the first three joints, with which these attacks were found."""


class Thrown(NamedTuple):
    """Largest speed, rad/s, and torque, N·m, (n,) each, before and from the push, and of the tool, m/s."""

    speed: Floats
    speed_before: Floats
    torque: Floats
    tool_speed: float


def throw(spec, drawn, poses, moves, tick, push, gains=None, prepare=lambda runtime: None):
    """Move joints from one pose to another from ticks `moves` on, and push a link along a motion, None: its own."""
    seeds, (link, motion) = [robot_seed(0, 0)], push
    contract = attack_contract(spec, ControlMode.POSITION, gains)
    runtime, arm = simulate(spec, contract, seeds, draw=drawn)
    prepare(runtime)
    arm.plant.wear.life[:] = LIVES
    arm.plant.wear.apply()
    pushes = arm.plant.disturbances["pushes"]
    (speed, torque), tool_speed = np.zeros((2, spec.n)), 0.0
    for k in range(tick + LOOKED_AT):
        if k == ARMED:
            runtime.arm(np.ones(1, dtype=bool))
        runtime.sense()
        runtime.act(np.where(k >= moves, *poses[::-1])[None])
        truth = arm.truth()
        speed, torque = np.maximum(speed, np.abs(truth.qd[0])), np.maximum(torque, np.abs(truth.tau[0]))
        tool_speed = max(tool_speed, float(np.linalg.norm(truth.tool_velocity)))
        if k == tick:
            before, torque = speed, np.zeros(spec.n)
            q, along = (
                (truth.q, motion) if motion is not None else (runtime.setpoint.q, runtime.setpoint.qd[0])
            )
            push_n, offset = drawn["push.force_n"][0], drawn["links.com_m"][0, link]
            force = push_n * direction(q[0], along, link, offset)
            pushes._applied[0, pushes._bodies[len(pushes._bodies) - spec.n + link], :3] = force
    return Thrown(speed, before, torque, tool_speed)


def robot_of(seed, robot, disturbed):
    """Draw one robot of a seed."""
    return draw(load_distributions(SPEC), SPEC, [robot_seed(seed, robot)]).replaced(disturbed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "joint", "link", "tick", "pose"),
    [
        (304, 4, 5, 582, (-0.540, -1.721, 1.055, -1.105, -0.608, 1.565)),
        (693, 3, 4, 478, (-0.409, -1.975, 1.854, -2.408, -0.600, 0.430)),
    ],
)
def test_a_push_through_worn_play_keeps_the_limit_of_speed(robot, joint, link, tick, pose):
    """Robots and poses of an attack, which came to 1.061 and 1.066 where 0.83 of the limit was planned."""
    first, last = np.tile(pose, (2, 1))
    last[joint], first[joint] = (end[joint] for end in SPEC.pose_range)
    drawn = robot_of(2, robot, WITHOUT_PAYLOAD)
    found = throw(SPEC, drawn, (first, last), MOVES, tick, (link, of_joint(joint, -1.0)))
    limit = SPEC.joint_array("qd_max")[joint]
    assert found.speed_before[joint] < 0.8 * limit
    assert 0.9 * limit < found.speed[joint] <= limit


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "low", "high"), [("0.064", 0.7, 0.9), ("0.12", 0.99, np.inf)])
def test_a_blow_in_the_play_takes_all_of_the_torque_only_with_more_damping(tmp_path, damping, low, high):
    """Robot and pose of an attack: the stretched arm swings its pan, and the push begins as the planner brakes."""
    spec = load_robot(copy_of_arm(tmp_path, toml=FORMER, xml=[("0.064 0 0 48", f"{damping} 0 0 48")]))
    first, last = np.tile((0.0, -0.4973, 0.5101, -1.6896, -0.9839, 0.0), (2, 1))
    first[0], last[0] = -0.9, 0.9
    found = throw(spec, robot_of(3, 6531, WITH_PAYLOAD), (first, last), 300, 467, (5, of_joint(0, 1.0)))
    assert low < found.torque[0] / torque_max(spec)[0] < high


SOFTEST = TrainedGains(
    kp=(33721.0, 33721.0, 20971.0, 1594.9, 1036.6, 933.4), kd=(574.7, 578.6, 276.8, 26.8, 20.7, 19.4)
)
"""Gains of a contract just above the lower bounds of then."""


@pytest.mark.slow
@pytest.mark.parametrize(("planned", "low", "high"), [("0.88", 0.9, 0.98), ("0.92", 1.0, np.inf)])
def test_a_push_as_a_stop_begins_needs_the_margin_of_the_tools_speed(tmp_path, planned, low, high):
    """Robot, motion and push of an attack: gears have no load then, and links fly through their play one by one."""
    spec = load_robot(copy_of_arm(tmp_path, toml=[*FORMER, ("tool_speed = 0.87", f"tool_speed = {planned}")]))
    poses = ((1.2, -1.768, 0.6403, -2.9468, -0.55, -2.4624), (-0.79, -1.06, 2.2355, -2.374, -2.148, -2.8215))
    moves = MOVES + np.array((25, 20, 44, 45, 58, 83))
    drawn = robot_of(1, 10314, WITHOUT_PAYLOAD)
    speeds = [
        throw(spec, drawn, poses, moves, tick, (5, None), SOFTEST).tool_speed for tick in range(504, 510, 2)
    ]
    assert low < max(speeds) / SPEC.workspace.tool_speed_max < high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("former", "ticks", "low", "high"),
    [(True, (541,), 0.995, np.inf), (False, (511, 516, 521, 541), 0.85, 0.95)],
)
def test_a_push_while_a_stop_holds_a_loaded_arm_up_keeps_the_limit_of_torque(
    tmp_path, former, ticks, low, high
):
    """Robot, motion and push of an attack: elbow and wrists brake, too, and the lift holds against all of them."""
    spec = load_robot(copy_of_arm(tmp_path, toml=FORMER)) if former else SPEC
    prepare = skip_stop_checks("braking") if former else lambda runtime: None
    poses = ((-0.938, -0.66, 0.353, -1.885, -1.919, 1.888), (0.316, -0.537, 1.987, -1.497, -0.579, -2.509))
    drawn, push = robot_of(1, 6794, WITH_PAYLOAD), (5, of_joint(1, 1.0))
    torques = [throw(spec, drawn, poses, 500, tick, push, prepare=prepare).torque[1] for tick in ticks]
    assert low < max(torques) / torque_max(spec)[1] < high
