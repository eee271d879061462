"""Small ONNX graphs, node by node."""

import numpy as np
from onnx import TensorProto, helper, numpy_helper

FLOAT = TensorProto.FLOAT
ZERO = {"zero": np.zeros((), np.float32)}


def node(kind, inputs, outputs, **attributes):
    return helper.make_node(kind, inputs.split(), outputs.split(), name=outputs.split()[-1], **attributes)


def graph(*nodes, inputs="x", outputs="y", held=None, shape=("batch", 3), rank=2):
    """A model from inputs of one shape to outputs of any shape of `rank`."""
    ends = [
        [helper.make_tensor_value_info(name, FLOAT, size) for name in names.split()]
        for names, size in ((inputs, shape), (outputs, "abc"[:rank]))
    ]
    weights = [numpy_helper.from_array(np.asarray(array), name) for name, array in (held or {}).items()]
    made = helper.make_graph(list(nodes), "g", *ends, weights)
    return helper.make_model(made, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)


def body(kind="Add", held=None, **more):
    ends = [
        [helper.make_tensor_value_info(name, FLOAT, []) for name in names] for names in (("s", "r"), ("t",))
    ]
    weights = [numpy_helper.from_array(array, name) for name, array in (held or {}).items()]
    return helper.make_graph([node(kind, "s r", "t", **more)], "body", *ends, weights)
