"""Graphs of other libraries."""

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from policies.importers.readers import read_policy
from policies.importers.torch_files.network_settings import NetworkSettings
from robots.errors import ContractError


def test_a_graph_is_tried_in_a_separate_process_first(arm_policy, crashing_trial):
    with pytest.raises(ContractError, match=f"^{arm_policy}: {crashing_trial}$"):
        read_policy(arm_policy, NetworkSettings())


def declaring_six(path, actions, *, as_scalar=False):
    """A graph with memory that declares six actions for each robot, and gives others."""
    weights = numpy_helper.from_array(np.ones((6, actions), np.float32), "w")
    nodes = [
        helper.make_node("MatMul", ["obs", "w"], ["a"]),
        helper.make_node("ReduceSum", ["a"], ["sum"], keepdims=0),
        helper.make_node("Tanh", ["h_in"], ["h_out"]),
        helper.make_node("ReduceSum", ["h_in"], ["h"], keepdims=0),
        helper.make_node("Add", ["sum" if as_scalar else "a", "h"], ["actions"]),
    ]
    inputs, outputs = (
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in each]
        for each in ((("obs", [1, 6]), ("h_in", [1, 1, 2])), (("actions", [1, 6]), ("h_out", [1, 1, 2])))
    )
    graph = helper.make_graph(nodes, "g", inputs, outputs, [weights])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path)
    return path


@pytest.mark.parametrize(("actions", "as_scalar", "found"), [(5, False, "(1, 5)"), (6, True, "()")])
def test_actions_of_another_shape_than_declared_are_refused(tmp_path, actions, as_scalar, found):
    path = declaring_six(tmp_path / "policy.onnx", actions, as_scalar=as_scalar)
    reference = read_policy(path, NetworkSettings())
    with pytest.raises(ContractError) as caught:
        reference.run(np.zeros((2, 6), np.float32), np.ones(2, bool))
    assert str(caught.value) == f"{path}: 'actions': found shape {found}, expected (1, 6) as declared"
