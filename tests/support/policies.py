import json

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from deploy.policy.policy import Policy
from deploy.policy.policy_names import CONTRACT_KEY, GOLDEN_KEY
from support.arm6 import SPEC
from support.contracts import arm_contract

N, A, HIDDEN = 30, 6, 32


def weights(seed=0):
    rng = np.random.default_rng(seed)
    shapes = {"w0": (N, HIDDEN), "b0": (HIDDEN,), "w1": (HIDDEN, A), "b1": (A,)}
    return {name: rng.normal(0, 0.3, shape).astype(np.float32) for name, shape in shapes.items()}


def by_numpy(observation, w):
    """The oracle: float64, other code."""
    hidden = observation.astype(float) @ w["w0"].astype(float) + w["b0"]
    hidden = np.where(hidden > 0, hidden, np.expm1(np.minimum(hidden, 0)))
    return hidden @ w["w1"].astype(float) + w["b1"]


def golden(w):
    observation = np.random.default_rng(1).normal(size=(16, N)).astype(np.float32)
    action = by_numpy(observation, w).astype(np.float32)
    return {"observation": observation.tolist(), "action": action.tolist()}


def policy_model(contract=None):
    """A small policy with everything that it needs."""
    w = weights()
    nodes = [
        helper.make_node("Gemm", ["observation", "w0", "b0"], ["h"]),
        helper.make_node("Elu", ["h"], ["e"]),
        helper.make_node("Gemm", ["e", "w1", "b1"], ["action"]),
    ]
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size])
        for name, size in (("observation", N), ("action", A))
    ]
    tensors = [numpy_helper.from_array(array, name) for name, array in w.items()]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    contract = contract or arm_contract()
    helper.set_model_props(model, {CONTRACT_KEY: contract.to_json(), GOLDEN_KEY: json.dumps(golden(w))})
    return model


def saved(model, folder):
    path = folder / "policy.onnx"
    path.write_bytes(model.SerializeToString())
    return path


def loaded(folder, model=None):
    return Policy.load(saved(model or policy_model(), folder), SPEC)


def tensor(model, name):
    return next(t for t in model.graph.initializer if t.name == name)


def metadata(model, key):
    return next(p for p in model.metadata_props if p.key == key)
