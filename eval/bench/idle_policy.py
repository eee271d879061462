"""Idle policy, made from a working one: a budget must refuse it."""

import json
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

from deploy.policy.policy_file import GOLDEN_KEY, OUTPUT


def make_idle(policy: Path, out: Path) -> Path:
    """Copy a policy with its last layer and its golden actions set to zero; return `out`."""
    model = onnx.load(policy)
    last = next(node for node in model.graph.node if OUTPUT in node.output)
    for tensor in model.graph.initializer:
        if tensor.name in last.input:
            zeros = np.zeros_like(numpy_helper.to_array(tensor))
            tensor.CopyFrom(numpy_helper.from_array(zeros, tensor.name))
    for prop in model.metadata_props:
        if prop.key == GOLDEN_KEY:
            pairs = json.loads(prop.value)
            pairs["action"] = np.zeros_like(pairs["action"]).tolist()
            prop.value = json.dumps(pairs)
    onnx.save(model, out)
    return out
