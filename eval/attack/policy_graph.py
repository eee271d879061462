"""ONNX policies of adversaries: the graph of `weights.py`, with memory for the time and for delayed commands."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from onnx import GraphProto, NodeProto, TensorProto, helper, numpy_helper

from deploy.policy.contract import Contract
from deploy.policy.contract_action import ActionSpec
from deploy.policy.contract_term import Term
from deploy.policy.inference import load_session
from deploy.policy.policy_file import PolicyFile
from deploy.policy.policy_names import CONTRACT_KEY, GOLDEN_KEY, INPUT, MEMORY, NEXT, OUTPUT
from deploy.sources.catalogue import SOURCES
from deploy.tasks.task import tasks_of
from eval.attack.trained_gains import TrainedGains
from eval.attack.weights import DELAY_MAX, Weights, arrays
from robots.arrays import Float32s, Floats
from robots.errors import ConfigError
from robots.models.nominal_model import torque_max
from robots.motors.control_mode import ControlMode
from robots.spec import RobotSpec
from robots.strict import parse

OPSET, IR = 18, 10
GRAPH = """
q = Slice observation zero n one
v = Slice observation n 2n one
step = Slice memory zero one one
line = Slice memory one size one
t = Mul step dt
delays = Reshape line lines
picked = Mul delays chosen
delayed = ReduceSum picked one
damped = Mul v damping
angle = Mul q dither_rate
noise = Sin angle
dithered = Mul noise dither
turned = Mul t wave_hz
squared = Mul t t
swept = Mul squared half_chirp
wave_phase = Sum turned swept wave_turns
wave_angle = Mul wave_phase turn
wave_sine = Sin wave_angle
waved = Mul wave_sine wave
swing_time = Mul t swing_hz
swing_phase = Add swing_time swing_turns
swing_angle = Mul swing_phase turn
swing_sine = Sin swing_angle
swung = Mul swing_sine swing
late = Sub t step_s
side = Sign late
stepped = Mul side step_to
from_home = Sub q home
pulled = Mul from_home pull
repeated = Mul delayed replay
seen = Concat from_home v delayed
column = Unsqueeze seen two
products = Mul column inward
inputs = ReduceSum products one
biased = Add inputs bias
hidden = Tanh biased
hidden_column = Unsqueeze hidden two
shares = Mul hidden_column outward
said = ReduceSum shares one
drive = Sum damped dithered waved swung push stepped pulled repeated said
sharp = Mul drive sharpness
command = Tanh sharp
reached = Mul command reach
followed = Mul q follow
until = Sub t refused_s
off = Abs until
outside = Sub off half_step
number = Sqrt outside
nothing = Mul number none
action = Sum followed centre reached nothing
next_step = Add step one_step
older = Slice line zero kept one
next_memory = Concat next_step command older
"""
"""Nodes, each: name = operator inputs. Sums of products stand for matrices: a row depends on that row alone. The root
of a negative number is no number, and stays none when it is multiplied by 0."""


def attack_contract(spec: RobotSpec, mode: ControlMode, gains: TrainedGains | None = None) -> Contract:
    """Return the contract of all adversaries: they act in every tick, and nothing bounds their actions.

    Raises:
        ConfigError: no task suits the robot, or the gains do not suit the mode.
    """
    scale = {
        ControlMode.POSITION: np.ones(spec.n),
        ControlMode.VELOCITY: spec.joint_array("qd_max"),
        ControlMode.TORQUE: torque_max(spec),
    }[mode]
    offset = {"offset": (0.0,) * spec.n} if mode is ControlMode.POSITION else {}
    tasks = tasks_of(spec)
    if not tasks:
        raise ConfigError(
            f"{spec.folder}: no task for this robot: found no workspace, feet or goal that one needs"
        )
    fields = {
        "mode": mode.name.lower(),
        "size": spec.n,
        "scale": tuple(scale.tolist()),
        "clip": None,
        **offset,
        **(gains._asdict() if gains else {}),
    }
    return Contract(
        robot=spec.name,
        robot_digest=spec.digest,
        joint_names=spec.joint_names,
        policy_hz=spec.rates.control_hz,
        control_hz=spec.rates.control_hz,
        task=tasks[0],
        observation=(
            _term("joint_position", np.ones(spec.n)),
            _term("joint_velocity", spec.joint_array("qd_max")),
        ),
        action=parse(fields, ActionSpec, source="gains"),
        memory=1 + DELAY_MAX * spec.n,
        trained={"recipe": "soak-attack"},
    )


def _term(source: str, scale: Floats) -> Term:
    known = SOURCES[source]
    return Term(
        name=source,
        source=source,
        frame=known.frame,
        unit=known.unit,
        size=len(scale),
        scale=tuple(scale.tolist()),
    )


def policy_file(
    spec: RobotSpec, mode: ControlMode, rows: Sequence[Weights], gains: TrainedGains | None = None
) -> PolicyFile:
    """Return the policy of some weights; of several, one that gives every robot its own, for as many robots."""
    contract = attack_contract(spec, mode, gains)
    graph = _graph(contract, _tensors(spec, mode, arrays(rows, spec.n)))
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
    observation = np.zeros((len(rows), contract.observation_size), dtype=np.float32)
    action = _action(model.SerializeToString(), observation, contract.memory)
    golden = {"observation": observation.tolist(), "action": action.tolist()}
    helper.set_model_props(model, {CONTRACT_KEY: contract.to_json(), GOLDEN_KEY: json.dumps(golden)})
    data = model.SerializeToString()
    digest = hashlib.sha256(data).hexdigest()
    return PolicyFile(data=data, digest=digest, contract=contract, observation=observation, action=action)


def _action(data: bytes, observation: Float32s, memory: int) -> Float32s:
    """Return the first action of a graph, for golden pairs."""
    robots = len(observation)
    feeds = {INPUT: observation, MEMORY: np.zeros((robots, memory), dtype=np.float32)}
    return np.asarray(load_session(data, "adversary", (robots,)).run([OUTPUT], feeds)[0])


def _graph(contract: Contract, tensors: dict[str, NDArray[Any]]) -> GraphProto:
    observations, actions, memory = contract.observation_size, contract.action_size, contract.memory
    inputs, outputs = (
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size])
            for name, size in each.items()
        ]
        for each in ({INPUT: observations, MEMORY: memory}, {OUTPUT: actions, NEXT: memory})
    )
    constants = [numpy_helper.from_array(array, name) for name, array in tensors.items()]
    return helper.make_graph(list(_nodes()), "adversary", inputs, outputs, constants)


def _nodes() -> Iterator[NodeProto]:
    attributes: dict[str, dict[str, Any]] = {"Concat": {"axis": 1}, "ReduceSum": {"keepdims": 0}}
    for line in GRAPH.strip().splitlines():
        name, _, operator, *inputs = line.split()
        yield helper.make_node(operator, inputs, [name], **attributes.get(operator, {}))


def _tensors(spec: RobotSpec, mode: ControlMode, weights: dict[str, Floats]) -> dict[str, NDArray[Any]]:
    """Return the constants of the graph for R policies; numbers of all joints are (R, 1)."""
    n, home, angles = spec.n, spec.joint_array("q_home"), mode is ControlMode.POSITION
    numbers = {name: each[:, None] if each.ndim == 1 else each for name, each in weights.items()}
    follow = numbers["follow"] * angles
    chosen = np.arange(1, DELAY_MAX + 1) == numbers.pop("delay")
    numbers |= {"follow": follow, "centre": (1.0 - follow) * home * angles, "chosen": chosen[:, :, None]}
    numbers |= {"half_chirp": numbers.pop("chirp") / 2, "home": home, "dt": np.array([spec.dt])}
    numbers |= {"step_to": numbers.pop("step"), "pull": numbers.pop("spring") * (angles - 1.0)}
    numbers |= {"one_step": np.ones(1), "turn": np.array([2.0 * np.pi])}
    numbers |= {"half_step": np.array([spec.dt / 2]), "none": np.zeros(1)}
    places = {"zero": [0], "one": [1], "two": [2], "n": [n], "2n": [2 * n], "lines": [-1, DELAY_MAX, n]}
    places |= {"size": [1 + DELAY_MAX * n], "kept": [(DELAY_MAX - 1) * n]}
    return {name: np.array(place, dtype=np.int64) for name, place in places.items()} | {
        name: np.asarray(number, dtype=np.float32) for name, number in numbers.items()
    }
