"""What a graph inside a graph may hold: robots one after the other, and nothing that a graph outside may not."""

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from deploy.policy.onnx_graph import PARTS_MAX, check_model
from robots.errors import ContractError
from support.policies import A, N, by_numpy, loaded, policy_model, weights


def one_by_one():
    """The small policy of test_policy, robot after robot."""
    model = policy_model()
    nodes, tensors = list(model.graph.node), list(model.graph.initializer)
    shapes = {"row": [1, N], "flat": [A]}
    tensors += [numpy_helper.from_array(np.array(s), name) for name, s in shapes.items()]
    nodes[0].input[0], nodes[-1].output[0] = "as_row", "as_rows"
    nodes.insert(0, helper.make_node("Reshape", ["seen", "row"], ["as_row"]))
    nodes.append(helper.make_node("Reshape", ["as_rows", "flat"], ["done"]))
    ends = [helper.make_tensor_value_info(*end) for end in (("seen", 1, [N]), ("done", 1, [A]))]
    body = helper.make_graph(nodes, "one", ends[:1], ends[1:], tensors)
    del model.graph.node[:], model.graph.initializer[:]
    scan = helper.make_node("Scan", ["observation"], ["action"], name="robots", body=body, num_scan_inputs=1)
    model.graph.node.append(scan)
    return model


def body_of(model):
    return next(attribute.g for attribute in model.graph.node[0].attribute if attribute.name == "body")


@pytest.mark.parametrize("robots", [1, 5, 64])
def test_a_scan_over_robots_is_a_policy(tmp_path, robots):
    observation = np.random.default_rng(robots).normal(size=(robots, N)).astype(np.float32)
    action = loaded(tmp_path, one_by_one()).step(observation)
    np.testing.assert_allclose(action, by_numpy(observation, weights()), rtol=0, atol=1e-5)


def nested(body):
    inner = helper.make_graph([], "inner", [], [])
    body.node.append(helper.make_node("Scan", ["seen"], ["x"], name="again", body=inner, num_scan_inputs=1))


def loop(body):
    body.node.append(
        helper.make_node("Loop", ["", ""], ["x"], name="spin", body=helper.make_graph([], "b", [], []))
    )


def foreign_node(body):
    body.node[1].domain = "evil"


def long_names(body):
    body.node[1].domain = "evil" * 10_000


def nan_weight(body):
    array = numpy_helper.to_array(body.initializer[0]).copy()
    array[0, 0] = np.nan
    body.initializer[0].CopyFrom(numpy_helper.from_array(array, body.initializer[0].name))


def external(body):
    onnx.external_data_helper.set_external_data(body.initializer[0], "/etc/passwd")
    body.initializer[0].data_location = TensorProto.EXTERNAL


def sparse(body):
    values = numpy_helper.from_array(np.ones(1, np.float32), "s")
    body.sparse_initializer.append(
        helper.make_sparse_tensor(values, numpy_helper.from_array(np.zeros(1, int), "i"), [9])
    )


def sparse_constant(body, change):
    values = numpy_helper.from_array(np.ones(1, np.float32), "few")
    change(values)
    made = helper.make_sparse_tensor(values, numpy_helper.from_array(np.zeros(1, int), "i"), [9])
    body.node.append(helper.make_node("Constant", [], ["thin"], sparse_value=made))


def sparse_nan(body):
    sparse_constant(body, lambda values: values.CopyFrom(numpy_helper.from_array(np.full(1, np.nan), "few")))


def sparse_external(body):
    sparse_constant(body, lambda values: onnx.external_data_helper.set_external_data(values, "weights"))


def random(body):
    body.node.append(helper.make_node("RandomUniformLike", [body.input[0].name], ["chance"], name="dice"))


def training_dropout(body):
    name = body.input[0].name
    body.node.append(helper.make_node("Dropout", [name, "ratio", "training"], ["chance"], name="dice"))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            random,
            "node 'dice': found RandomUniformLike, which may draw random numbers, expected the same outputs for"
            " the same inputs",
        ),
        (
            training_dropout,
            "node 'dice': found Dropout, which may draw random numbers, expected the same outputs for"
            " the same inputs",
        ),
        (nested, "node 'again': found Scan with a graph of its own, expected none"),
        (loop, "node 'spin': found Loop with a graph of its own, expected none"),
        (foreign_node, "operator domain: found 'evil', expected only ai.onnx"),
        (long_names, "levilevi, expected only ai.onnx"),
        (nan_weight, "found 1 of 960 weights NaN or infinite, expected all finite"),
        (external, "found external data, expected all weights in the one file"),
        (sparse_nan, "tensor 'few': found 1 of 1 weights NaN or infinite, expected all finite"),
        (sparse_external, "found external data, expected all weights in the one file"),
        (sparse, "found sparse weights, expected dense weights"),
    ],
)
def test_subgraphs_are_checked_like_the_graph(tmp_path, spoil, message):
    model = one_by_one()
    spoil(body_of(model))
    with pytest.raises(ContractError) as caught:
        loaded(tmp_path, model)
    assert str(caught.value).endswith(message)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


def many_nodes(body):
    body.node.extend([body.node[1]] * PARTS_MAX)


def many_inputs(body):
    body.node.append(helper.make_node("Sum", [body.input[0].name] * PARTS_MAX, ["sum"]))


def many_outputs(body):
    names = [f"part{k}" for k in range(PARTS_MAX)]
    body.node.append(helper.make_node("Split", [body.input[0].name], names, num_outputs=PARTS_MAX))


@pytest.mark.parametrize("spoil", [many_nodes, many_inputs, many_outputs])
def test_parts_of_a_graph_are_counted_before_they_are_looked_at(tmp_path, spoil):
    model = one_by_one()
    spoil(body_of(model))
    counted = r"found \d+ nodes, their inputs, outputs and attributes, and tensors, at most 16384$"
    with pytest.raises(ContractError, match=counted):
        loaded(tmp_path, model)


FLOATS = "FLOAT16 BFLOAT16 FLOAT8E4M3FN FLOAT8E4M3FNUZ FLOAT8E5M2 FLOAT8E5M2FNUZ DOUBLE COMPLEX64 COMPLEX128"


@pytest.mark.parametrize("kind", FLOATS.split())
def test_weights_of_any_type_are_finite(kind):
    model, number = policy_model(), TensorProto.DataType.Value(kind)
    dtype = helper.tensor_dtype_to_np_dtype(number)
    held = numpy_helper.from_array(np.array([1.0, 2.0]).astype(dtype), "held")
    model.graph.initializer.append(held)
    check_model(model, "x.onnx")
    model.graph.initializer[-1].CopyFrom(
        numpy_helper.from_array(np.array([1.0, np.nan]).astype(dtype), "held")
    )
    assert model.graph.initializer[-1].data_type == number
    with pytest.raises(ContractError, match="'held': found 1 of 2 weights NaN or infinite, expected all"):
        check_model(model, "x.onnx")


def test_weights_that_are_text_or_small_integers_are_no_floats():
    model = policy_model()
    model.graph.initializer.append(numpy_helper.from_array(np.array(["nan"]), "text"))
    model.graph.initializer.append(helper.make_tensor("four", TensorProto.INT4, [2], [-1, 7]))
    check_model(model, "x.onnx")


def test_only_scan_may_hold_a_subgraph(tmp_path):
    model = one_by_one()
    model.graph.node[0].op_type = "If"
    with pytest.raises(ContractError, match="node 'robots': found If with a graph of its own, expected none"):
        loaded(tmp_path, model)
