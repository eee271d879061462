"""A small policy that remembers."""

import json

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from deploy.policy.contract import Contract
from deploy.policy.policy_names import CONTRACT_KEY, GOLDEN_KEY
from support.contracts import arm_contract
from support.policies import A, N

M = 7


def weights():
    rng = np.random.default_rng(3)
    shapes = {"w": (N, M), "u": (M, M), "v": (M, A)}
    return {name: rng.normal(0, 0.3, shape).astype(np.float32) for name, shape in shapes.items()}


def by_numpy(observations, forget=()):
    """The oracle: float64, one robot, which forgets everything before some steps."""
    w, h, actions = {name: array.astype(float) for name, array in weights().items()}, np.zeros(M), []
    for step, observation in enumerate(observations):
        h = np.zeros(M) if step in forget else h
        h = np.tanh(observation.astype(float) @ w["w"] + h @ w["u"])
        actions.append(h @ w["v"])
    return np.array(actions)


def remembering(*, memory=M, golden=None, frozen=False):
    """A model with memory; `frozen`, it never hands on what it should remember."""
    nodes = [
        helper.make_node("MatMul", ["observation", "w"], ["seen"]),
        helper.make_node("MatMul", ["memory", "u"], ["known"]),
        helper.make_node("Add", ["seen", "known"], ["both"]),
        helper.make_node("Tanh", ["both"], ["h"]),
        helper.make_node("MatMul", ["h", "v"], ["action"]),
        helper.make_node("Identity", ["memory" if frozen else "h"], ["next_memory"]),
    ]
    ends = {"observation": N, "memory": M, "action": A, "next_memory": M}
    infos = [helper.make_tensor_value_info(k, TensorProto.FLOAT, ["batch", n]) for k, n in ends.items()]
    tensors = [numpy_helper.from_array(array, name) for name, array in weights().items()]
    graph = helper.make_graph(nodes, "policy", infos[:2], infos[2:], tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    observation = np.random.default_rng(1).normal(size=(16, N)).astype(np.float32)
    pairs = {"observation": observation.tolist(), "action": by_numpy(observation).astype(np.float32).tolist()}
    contract = arm_contract().model_dump() | {"memory": memory}
    props = {CONTRACT_KEY: Contract(**contract).to_json(), GOLDEN_KEY: json.dumps(golden or pairs)}
    helper.set_model_props(model, props)
    return model
