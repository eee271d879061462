"""Bounds on memory and work of graphs, from their shapes alone: nothing of a graph that is refused was run."""

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from deploy.policy import graph_bounds
from deploy.policy.graph_bounds import check_bounds
from deploy.policy.inference import BATCHES, load_session
from deploy.policy.onnx_graph import check_model
from robots.errors import ContractError
from support.graphs import FLOAT, ZERO, body, graph, node


def filled(*shape):
    return node("ConstantOfShape", "n", "big"), {"n": np.array(shape)}


def elements():
    fill, held = filled(4_000_000_000)
    return graph(fill, node("ReduceMin", "big", "y", keepdims=0), held=held)


def product():
    fill, held = filled(3000, 3000)
    return graph(fill, node("MatMul", "big big", "y"), held=held)


def many_tensors():
    fill, held = filled(1 << 26)
    return graph(fill, *(node("Neg", "big", f"y{k}") for k in range(4)), outputs="y3", held=held)


def trips():
    fill, held = filled(100_000)
    return graph(fill, node("Scan", "zero big", "y", body=body(), num_scan_inputs=1), held=held | ZERO)


def long_trips():
    """A hundred trips, each with much work."""
    held = {"zero": np.zeros((1000, 1000), np.float32), "rows": np.zeros((100, 1), np.float32)}
    scan = node("Scan", "zero rows", "y", body=body("MatMul"), num_scan_inputs=1)
    scan.attribute[0].g.node[0].input[1] = "s"
    return graph(scan, held=held)


def remainders():
    """Of numbers that no trial sees."""
    fill, held = filled(5000)
    return graph(
        fill, node("Mod", "big big", "m", fmod=1), node("ReduceMin", "m", "y", keepdims=0), held=held
    )


def cut_off():
    """A long signal and a long kernel, of whose product one number is left."""
    fill, held = filled(1, 1, 8192)
    held["kernel"] = np.zeros((1, 1, 9000), np.float32)
    spread = node("ConvTranspose", "big kernel", "y", pads=[8595, 8595])
    return graph(fill, spread, held=held, rank=3)


def depends_on_data():
    return graph(node("NonZero", "x", "where"), node("Cast", "where", "y", to=FLOAT))


def declared():
    """A shape that the file declares is no evidence."""
    model = depends_on_data()
    model.graph.value_info.append(helper.make_tensor_value_info("where", TensorProto.INT64, [2, 1]))
    return model


def by_batch():
    """Nothing at batch 1, much at batch 64."""
    return graph(
        node("Transpose", "x", "t"),
        *(node("MatMul", "x t", f"w{k}") for k in range(1000)),
        outputs="w999",
        shape=("batch", 4000),
    )


def words():
    return graph(node("Identity", "text", "said"), node("Neg", "x", "y"), held={"text": np.array(["a"])})


def hidden_by_a_name():
    """A weight of the body with the name, and the size, of a smaller one outside."""
    inside = body(held={"n": np.array([1 << 30])})
    inside.node.insert(0, node("ConstantOfShape", "n", "big"))
    scan = node("Scan", "zero x", "y", body=inside, num_scan_inputs=1)
    return graph(scan, held=ZERO | {"n": np.array([1])}, shape=("batch",))


def joined_with_itself():
    """Values that double with every node: inference of the whole graph would list them all."""
    nodes = [node("Concat", f"c{k} c{k}", f"c{k + 1}", axis=0) for k in range(40)]
    return graph(node("Shape", "x", "c0"), *nodes, node("Cast", "c40", "y", to=FLOAT))


def indexed_by_itself():
    """Dimensions that double with every node."""
    nodes = [node("Gather", f"g{k} g{k}", f"g{k + 1}", axis=0) for k in range(40)]
    return graph(*nodes, node("Cast", "g40", "y", to=FLOAT), held={"g0": np.zeros((1, 1), np.int64)})


def split():
    return graph(node("Split", "x", "y", num_outputs=1 << 40))


def growing_state():
    scan = node("Scan", "start x", "y", body=body("Concat", axis=0), num_scan_inputs=1)
    return graph(scan, held={"start": np.zeros(1, np.float32)})


def changed_state():
    """A dimension from a state of which the value is known only before the Scan."""
    inside = body("Add")
    for value in (inside.input[0], inside.input[1], inside.output[0]):
        value.type.tensor_type.elem_type = TensorProto.INT64
    scan = node("Scan", "zero rows", "n", body=inside, num_scan_inputs=1)
    held = {"zero": np.array(0), "rows": np.full(100, 1 << 30), "one": np.array([1])}
    sized = node("Reshape", "n one", "size"), node("ConstantOfShape", "size", "y")
    return graph(scan, *sized, held=held, rank=1)


def another_body():
    return graph(node("Scan", "x", "y", body=body(), num_scan_inputs=1))


def scanning(inputs="zero x", count=1, **axes):
    return graph(node("Scan", inputs, "y", body=body(), num_scan_inputs=count, **axes), held=ZERO)


def sparse():
    values = numpy_helper.from_array(np.ones(1, np.float32), "v")
    made = helper.make_sparse_tensor(values, numpy_helper.from_array(np.zeros(1, np.int64), "i"), [1 << 30])
    constant = helper.make_node("Constant", [], ["big"], name="big", sparse_value=made)
    return graph(constant, node("ReduceMin", "big", "y", keepdims=0))


KNOWN = "expected one that follows from the shapes of the inputs"
SCAN = "of 1: node 'y' (Scan): found other inputs, outputs or axes than its graph has"
REFUSED = {
    "elements": (elements, "of 1: node 'big' (ConstantOfShape): found 4000000000 elements of an output"),
    "product": (product, "of 1: found 27009002050 multiply-adds in a step, expected at most 67108864"),
    "many tensors": (many_tensors, "of 1: found 1342177280 bytes of intermediate tensors, expected at most"),
    "trips": (trips, "of 1: node 'y' (Scan): found 100000 trips, expected at most 4096"),
    "long trips": (long_trips, "of 1: found 1000"),
    "remainders": (remainders, "of 1: found 8193"),
    "cut off": (cut_off, "of 1: found 7373"),
    "data": (
        depends_on_data,
        f"of 1: node 'where' (NonZero): found an output 'where' of unknown shape, {KNOWN}",
    ),
    "declared": (
        declared,
        f"of 1: node 'where' (NonZero): found an output 'where' of unknown shape, {KNOWN}",
    ),
    "batch": (by_batch, "of 64: found"),
    "words": (words, "of 1: 'text': found no numbers, expected a tensor of numbers"),
    "name": (
        hidden_by_a_name,
        "of 1: node 'y' (Scan): node 'big' (ConstantOfShape): found 1073741824 elements",
    ),
    "joined": (joined_with_itself, "of 1: node 'c26' (Concat): found 134217728 elements of an output"),
    "indexed": (indexed_by_itself, "of 1: node 'g6' (Gather): found 65 dimensions, expected at most 64"),
    "split": (split, "of 1: node 'y' (Split): num_outputs: found 1099511627776, expected 1"),
    "state": (growing_state, "of 1: node 'y' (Scan): found a state that changes its shape"),
    "changed state": (
        changed_state,
        f"of 1: node 'y' (ConstantOfShape): found an output 'y' of unknown shape, {KNOWN}",
    ),
    "body": (another_body, SCAN),
    "input axes": (lambda: scanning(scan_input_axes=[0, 0]), SCAN),
    "output axes": (lambda: scanning(scan_output_axes=[0]), SCAN),
    "states": (lambda: scanning("zero zero x"), SCAN),
    "sparse": (sparse, "of 1: node 'big' (Constant): found 1073741824 elements of an output"),
}


@pytest.mark.parametrize(("make", "message"), REFUSED.values(), ids=REFUSED)
def test_a_graph_that_needs_too_much_never_reaches_onnx_runtime(make, message, monkeypatch):
    model = make()
    check_model(model, "x.onnx")
    monkeypatch.setattr("onnxruntime.InferenceSession", lambda *_, **__: pytest.fail("it was loaded"))
    with pytest.raises(ContractError) as caught:
        load_session(model.SerializeToString(), "x.onnx")
    assert str(caught.value).startswith(f"x.onnx: for a batch {message}")
    assert "\n" not in str(caught.value)


def mlp(width):
    layers = [node("MatMul", "x w0", "h0")]
    layers += [node("MatMul", f"h{k} w", f"h{k + 1}") for k in range(3)]
    held = {"w0": np.zeros((3, width), np.float32), "w": np.zeros((width, width), np.float32)}
    return graph(*layers, node("Neg", "h3", "y"), held=held)


def lstm(hidden, steps=50):
    held = {
        "w": np.zeros((1, 4 * hidden, 3), np.float32),
        "r": np.zeros((1, 4 * hidden, hidden), np.float32),
    }
    recurrent = node("LSTM", "x w r", "all last", hidden_size=hidden)
    return graph(recurrent, node("Neg", "last", "y"), held=held, shape=(steps, "batch", 3))


def computed_shape():
    """Shapes computed from the batch, as exporters of torch write them."""
    held = {"first": np.zeros((), np.int64), "axes": np.array([0]), "rest": np.array([1, 3])}
    nodes = (
        node("Shape", "x", "sizes"),
        node("Gather", "sizes first", "rows", axis=0),
        node("Unsqueeze", "rows axes", "row"),
        node("Concat", "row rest", "shape", axis=0),
        node("Reshape", "x shape", "y"),
    )
    return graph(*nodes, held=held, rank=3)


def test_networks_ten_times_as_large_as_those_of_robots_are_loaded():
    for model in (mlp(2048), lstm(512)):
        check_bounds(model, BATCHES, "x")


def test_shapes_computed_from_the_batch_are_known(monkeypatch):
    model = computed_shape()
    session = load_session(model.SerializeToString(), "x")
    assert session.run(None, {"x": np.ones((5, 3), np.float32)})[0].shape == (5, 1, 3)
    monkeypatch.setattr(graph_bounds, "ELEMENTS_MAX", 63 * 3)
    with pytest.raises(ContractError, match=r"for a batch of 64: node 'y' .*found 192 elements"):
        check_bounds(model, BATCHES, "x")
