"""Policies and robots with a mistake made on purpose, for whoever tests what finds mistakes."""

import json

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from deploy.policy.inference import load_session
from deploy.policy.policy_names import CONTRACT_KEY, GOLDEN_KEY
from robots.spec import load_robot
from support.arm6 import copy_of_arm
from support.policies import metadata


def ailing(path, folder, *, contract=None, graph=None):
    """The file of a policy with another contract or network, and golden pairs that agree as after a real export.

    Args:
        path: a sound one. folder: where the other goes.
        contract: changes the contract's plain data. graph: changes the model.
    """
    model = onnx.load(path)
    data = json.loads(metadata(model, CONTRACT_KEY).value)
    for change, what in ((contract, data), (graph, model)):
        if change is not None:
            change(what)
    metadata(model, CONTRACT_KEY).value = json.dumps(data)
    golden = json.loads(metadata(model, GOLDEN_KEY).value)
    rows = np.array(golden["observation"], np.float32)
    golden["action"] = (
        load_session(model.SerializeToString(), "x").run(None, {"observation": rows})[0].tolist()
    )
    metadata(model, GOLDEN_KEY).value = json.dumps(golden)
    ailing_path = folder / "ailing.onnx"
    ailing_path.write_bytes(model.SerializeToString())
    return ailing_path


def written(folder, nodes, arrays, contract):
    """The file of a network of some nodes and weights, with any contract."""
    sizes = {"observation": contract.observation_size, "action": contract.action_size}
    ends = [helper.make_tensor_value_info(k, TensorProto.FLOAT, ["batch", n]) for k, n in sizes.items()]
    tensors = [numpy_helper.from_array(x, name) for name, x in arrays.items()]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    golden = {name: [[0.0] * n] for name, n in sizes.items()}
    helper.set_model_props(model, {CONTRACT_KEY: contract.to_json(), GOLDEN_KEY: json.dumps(golden)})
    path = folder / "written.onnx"
    path.write_bytes(model.SerializeToString())
    return path


def without_normalizer(model):
    """What an export of the bare network leaves."""
    nodes = model.graph.node
    first = next(node for node in nodes if node.op_type == "Gemm")
    first.input[0] = "observation"
    for node in [node for node in nodes if node.op_type in ("Sub", "Div")]:
        nodes.remove(node)


def answering(*nodes, **tensors):
    """A change that puts nodes between the network and its action; the first takes "said", the last gives "action"."""

    def change(model):
        next(node for node in model.graph.node if node.output[0] == "action").output[0] = "said"
        model.graph.node.extend(nodes)
        model.graph.initializer.extend(numpy_helper.from_array(x, name) for name, x in tensors.items())

    return change


def in_front(node, **tensors):
    """A change that puts a node from "observation" to "theirs" before the network."""

    def change(model):
        first = next(each for each in model.graph.node if "observation" in each.input)
        first.input[0] = "theirs"
        model.graph.node.insert(0, node)
        model.graph.initializer.extend(numpy_helper.from_array(x, name) for name, x in tensors.items())

    return change


def louder(times):
    """Actions so many times as large."""
    return answering(
        helper.make_node("Mul", ["said", "times"], ["action"]), times=np.array(times, dtype=np.float32)
    )


def in_another_order(order, terms):
    """A network trained with joints in another order, under a contract that says nothing of it.

    Args:
        order: (n,) which of the robot's joints stands where in training's.
        terms: terms of the observation, as in the contract, whose joints are in that order.
    """
    columns, start = [], 0
    for each in terms:
        block = np.arange(start, start + each["size"])
        columns += block[order].tolist() if each["frame"] == "joint" else block.tolist()
        start += each["size"]

    def change(model):
        answering(helper.make_node("Gather", ["said", "order"], ["action"], axis=1), order=np.argsort(order))(
            model
        )
        gather = helper.make_node("Gather", ["observation", "columns"], ["theirs"], axis=1)
        in_front(gather, columns=np.array(columns))(model)

    return change


def robot_and_digest(folder, **edits):
    """The arm's folder with other text, and a change of contract that makes a policy one for it."""
    robot = copy_of_arm(folder, **edits)
    return robot, lambda data: data.update(robot_digest=load_robot(robot).digest)
