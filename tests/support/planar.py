"""The planar robots, contracts for them, and policies written by hand."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from deploy.policy.contract import Contract
from deploy.policy.contract_action import ActionSpec
from deploy.policy.policy_names import CONTRACT_KEY, GOLDEN_KEY
from robots.models.nominal_model import torque_max
from robots.motors.drive_gains import drive_gains
from robots.spec import load_robot
from support.contracts import term

PLANAR3, PLANAR4 = load_robot("planar3"), load_robot("planar4")
REACH_M, LINK_M, HINGES = 0.9, 0.3, 3


def planar_contract(spec=PLANAR3, mode="position_increment", **changes):
    """A contract for a planar robot with the observation of 9; full actions: 90°, or all speed or torque."""
    scales = {
        "joint_position": spec.pose_range[1],
        "tool_position": np.full(3, REACH_M),
        "goal_position": np.full(3, REACH_M),
    }
    n = spec.n
    by_mode = {
        "position_increment": {"scale": (0.06,) * n, "leash_rad": 0.3},
        "position": {"scale": (np.pi / 2,) * n, "offset": (0.0,) * n},
        "velocity": {"scale": tuple(spec.joint_array("qd_max"))},
        "torque": {"scale": tuple(torque_max(spec))},
    }
    fields = {
        "robot": spec.name,
        "robot_digest": spec.digest,
        "joint_names": spec.joint_names,
        "policy_hz": 50,
        "control_hz": 200,
        "task": "planar_reach",
        "observation": tuple(
            term(name, len(scale), scale=tuple(scale.tolist())) for name, scale in scales.items()
        ),
        "action": ActionSpec(mode=mode, size=n, clip=(-1.0, 1.0), **by_mode[mode]),
        "trained": {"recipe": "by hand"},
    }
    return Contract(**{**fields, **changes})


def graph_of(text):
    """Nodes from lines "name = Operator input input", the last of which is called "action"."""
    lines = [line.split() for line in text.strip().splitlines()]
    return [helper.make_node(operator, inputs, [name]) for name, _, operator, *inputs in lines]


def saved_policy(path, nodes, arrays, contract):
    """Write a network of some nodes and weights that answers zeros with zeros."""
    sizes = {"observation": contract.observation_size, "action": contract.action_size}
    inputs, outputs = {"observation": sizes["observation"]}, {"action": sizes["action"]}
    if contract.memory:
        inputs["memory"] = outputs["next_memory"] = contract.memory
    ends = [
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", n]) for name, n in each.items()]
        for each in (inputs, outputs)
    ]
    tensors = [numpy_helper.from_array(np.asarray(x, np.float32), name) for name, x in arrays.items()]
    graph = helper.make_graph(nodes, "policy", *ends, tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    golden = {name: [[0.0] * n] for name, n in sizes.items()}
    helper.set_model_props(model, {CONTRACT_KEY: contract.to_json(), GOLDEN_KEY: json.dumps(golden)})
    path.write_bytes(model.SerializeToString())
    return path


REACHING = """
x = MatMul observation of_x
z = MatMul observation of_z
side_of = MatMul observation of_side
side = Sign side_of
squares_x = Mul x x
squares_z = Mul z z
squares = Add squares_x squares_z
radius = Sqrt squares
links = Mul radius per_link
excess = Sub links one
half = Mul excess half_of_it
cosine = Clip half minus_one one
bend = Acos cosine
turned = Mul bend side
ahead = Add x tiny
slope = Div z ahead
direction = Atan slope
from_direction = MatMul direction by_direction
from_bend = MatMul turned by_bend
action = Add from_direction from_bend
"""
"""Inverse kinematics with elbow and wrist bent alike: r = l (1 + 2 cos b), shoulder at the goal's angle less b."""
STICKING = 0.005
"""m of a goal's height that a radian of the elbow outweighs: the side of the bend stays in a camera's noise."""


def joint_angles(goal):
    """Return (K, 3) rad that bring the tool to goals (K, 3) m: what the network of `reaching` computes."""
    bend = np.arccos(np.clip((np.hypot(goal[:, 0], goal[:, 2]) / LINK_M - 1) / 2, -1, 1)) * np.sign(
        goal[:, 2]
    )
    return np.stack((np.arctan2(goal[:, 2], goal[:, 0]) - bend, bend, bend), axis=1)


def reaching(path, spec=PLANAR3):
    """A policy that sends the joints where the tool is at the goal, by the nominal lengths of the links."""
    contract, n = planar_contract(spec, "position"), spec.n
    of_x, of_z, of_side = np.zeros((3, contract.observation_size, 1))
    of_x[n + 3] = of_z[n + 5] = of_side[n + 5] = REACH_M
    of_side[1] = STICKING * np.pi / 2
    full, rest = 2 / np.pi, (0.0,) * (n - HINGES)
    arrays = {
        **{"of_x": of_x, "of_z": of_z, "of_side": of_side, "tiny": 1e-9},
        **{"per_link": 1 / LINK_M, "one": 1.0, "half_of_it": 0.5, "minus_one": -1.0},
        "by_direction": np.array([[full, 0.0, 0.0, *rest]]),
        "by_bend": np.array([[-full, full, full, *rest]]),
    }
    return saved_policy(path, graph_of(REACHING), arrays, contract)


def trembling(path, spec=PLANAR3, mode="position_increment", seed=0, contract=None):
    """A policy of full actions that look random: the sine of a large multiple of noisy observations."""
    contract = contract or planar_contract(spec, mode)
    weights = np.random.default_rng(seed).normal(0, 1e4, (contract.observation_size, spec.n))
    nodes = graph_of("phase = MatMul observation weights\nsine = Sin phase\naction = Mul sine three")
    return saved_policy(path, nodes, {"weights": weights, "three": 3.0}, contract)


def failing(path, steps, spec=PLANAR3):
    """A policy that stays where it is for some steps, and then reads beyond the end of a tensor."""
    contract = planar_contract(spec, "position_increment", memory=1)
    nodes = [
        *graph_of("next_memory = Add memory one\nnone = MatMul observation zeros"),
        helper.make_node("Cast", ["memory"], ["step"], to=TensorProto.INT64),
        *graph_of("rows = Gather table step\nflat = Flatten rows\naction = Add none flat"),
    ]
    zeros = np.zeros((contract.observation_size, spec.n))
    arrays = {"one": [[1.0]], "zeros": zeros, "table": np.zeros((steps, spec.n))}
    return saved_policy(path, nodes, arrays, contract)


HOSTILE = """
next_memory = Add memory one
rates = MatMul observation rate
phase = Mul memory rates
sine = Sin phase
action = Sign sine
"""


def hostile(path, spec=PLANAR3, mode="position"):
    """A policy that throws every joint from one limit to the other, at rates that follow from the goal."""
    contract = planar_contract(spec, mode, memory=1)
    # Up to 2 rad in a policy step: from seconds at a limit to shaking.
    rate = np.zeros((contract.observation_size, spec.n))
    rate[-3:] = np.random.default_rng(1).uniform(-1.0, 1.0, (3, spec.n))
    return saved_policy(path, graph_of(HOSTILE), {"one": [[1.0]], "rate": rate}, contract)


STOPS = ' range="-1.658 1.658"'


def arm_with_wheel(folder, wheel="wrist_roll"):
    """The folder of planar4 with a wheel in place of a joint, by default the last one: the same without ends."""
    robot = Path(folder) / "planar4"
    shutil.copytree(PLANAR4.folder, robot)
    text = (robot / "model.xml").read_text().replace(STOPS, "")
    for joint in set(PLANAR4.joint_names) - {wheel}:
        text = text.replace(f'<joint name="{joint}"', f'<joint name="{joint}"{STOPS}')
    (robot / "model.xml").write_text(text)
    head, *joints = (robot / "robot.toml").read_text().split("[[joints]]")
    ends = re.compile("q_(min|max) = .*\n")
    joints = [ends.sub("", text) if f'name = "{wheel}"' in text else text for text in joints]
    (robot / "robot.toml").write_text("[[joints]]".join((head, *joints)))
    return robot


def wheel_contract(spec, mode="velocity"):
    """A contract by which the last joint follows speeds without stiffness, and the others hold their angles."""
    gains, contract = drive_gains(spec), planar_contract(spec, mode)
    stiffness = (*gains.kp[:-1].tolist(), 0.0)
    action = contract.action.model_copy(update={"kp": stiffness, "kd": tuple(gains.kd.tolist())})
    return contract.model_copy(update={"action": action})
