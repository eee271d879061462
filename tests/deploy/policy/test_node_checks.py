"""Nodes that would crash ONNX Runtime, or never end: refused before it loads them."""

import numpy as np
import pytest
from onnx import TensorProto, numpy_helper

from deploy.policy.inference import load_session
from deploy.policy.onnx_graph import check_model
from robots.errors import ContractError
from support.graphs import FLOAT, ZERO, body, graph, node

EXPECTED = "expected floating point, or a constant divisor without 0 and -1"
UNKNOWN = f"found integers with a divisor that is not a small constant, {EXPECTED}"


def refusal(model, monkeypatch):
    check_model(model, "x.onnx")
    monkeypatch.setattr("onnxruntime.InferenceSession", lambda *_, **__: pytest.fail("it was loaded"))
    with pytest.raises(ContractError) as caught:
        load_session(model.SerializeToString(), "x.onnx")
    return str(caught.value)


def divided(*divisor, kind="Div", to=TensorProto.INT64, held=None):
    """The input as integers, divided by `d`."""
    nodes = node("Cast", "x", "n", to=to), *divisor, node(kind, "n d", "q"), node("Cast", "q", "y", to=FLOAT)
    return graph(*nodes, held=held)


def stored(value, dtype):
    return node("Constant", "", "d", value=numpy_helper.from_array(np.array(value, dtype)))


def by_data(to):
    return divided(node("Cast", "x", "d", to=to), to=to)


def by_shape():
    """A divisor that is -1 for a batch of 65."""
    held = {"start": np.array([66]), "three": np.array([0])}
    shape = node("Shape", "x", "shape"), node("Gather", "shape three", "rows"), node("Sub", "start rows", "d")
    return divided(*shape, held=held)


def by_state():
    """A divisor that is a constant only before the first trip of a Scan."""
    inside = body("Sub")
    for value in (inside.input[0], inside.input[1], inside.output[0]):
        value.type.tensor_type.elem_type = TensorProto.INT64
    scan = node("Scan", "two rows", "d", body=inside, num_scan_inputs=1)
    return divided(scan, held={"two": np.array(2), "rows": np.ones(3, np.int64)})


def inside_a_scan():
    inside = body(held={"least": np.array(-(1 << 63))})
    inside.node.extend([node("Cast", "r", "d", to=TensorProto.INT64), node("Mod", "least d", "q")])
    return graph(node("Scan", "zero x", "y", body=inside, num_scan_inputs=1), held=ZERO, shape=("batch",))


REFUSED = {
    "data, 64 bits": (lambda: by_data(TensorProto.INT64), f"node 'q' (Div): {UNKNOWN}"),
    "data, 32 bits": (lambda: by_data(TensorProto.INT32), f"node 'q' (Div): {UNKNOWN}"),
    "batch": (by_shape, f"node 'q' (Div): {UNKNOWN}"),
    "state": (by_state, f"node 'q' (Div): {UNKNOWN}"),
    "Scan": (inside_a_scan, f"node 'y' (Scan): node 'q' (Mod): {UNKNOWN}"),
    "weights": (
        lambda: divided(held={"d": np.array([2, -1, 3])}),
        f"node 'q' (Div): found integers with a divisor of -1, {EXPECTED}",
    ),
    "zero": (
        lambda: divided(kind="Mod", held={"d": np.array([0, -1, 3])}),
        f"node 'q' (Mod): found integers with a divisor of 0, {EXPECTED}",
    ),
    "Constant": (
        lambda: divided(stored(-1, np.int32), to=TensorProto.INT32),
        f"node 'q' (Div): found integers with a divisor of -1, {EXPECTED}",
    ),
    "many weights": (
        lambda: divided(held={"d": np.full((500, 3), 2)}),
        f"node 'q' (Div): {UNKNOWN}",
    ),
}


@pytest.mark.parametrize(("make", "message"), REFUSED.values(), ids=REFUSED)
def test_integers_are_divided_only_by_safe_constants(make, message, monkeypatch):
    assert refusal(make(), monkeypatch) == f"x.onnx: for a batch of 1: {message}"


def test_work_that_follows_from_numbers_is_refused(monkeypatch):
    """Regions of a policy's state may grow to millions of samples in a step."""
    held = {"picture": np.ones((1, 1, 4, 4), np.float32), "which": np.zeros(1, np.int64)}
    model = graph(node("RoiAlign", "picture x which", "y"), held=held, shape=("batch", 4))
    said = "node 'y' (RoiAlign): expected an operator whose work follows from the shapes of its inputs"
    assert refusal(model, monkeypatch) == f"x.onnx: for a batch of 1: {said}"


@pytest.mark.parametrize("kind", ["Div", "Mod"])
@pytest.mark.parametrize("dtype", [np.int32, np.int64])
def test_the_smallest_integer_may_be_divided_by_other_constants(kind, dtype):
    least = {"least": np.array(np.iinfo(dtype).min, dtype)}
    quotient = node(kind, "least d", "q"), node("Cast", "q", "f", to=FLOAT), node("Add", "f x", "y")
    for divisor, held in (([], {"d": np.array([2, -2, 3], dtype)}), ([stored(-3, dtype)], {})):
        model = graph(*divisor, *quotient, held=least | held)
        load_session(model.SerializeToString(), "x").run(None, {"x": np.ones((1, 3), np.float32)})


@pytest.mark.parametrize("kind", ["Div", "Mod"])
@pytest.mark.parametrize("dtype", [np.int8, np.int16])
def test_small_integers_divide_without_a_crash(kind, dtype):
    """They are not refused: C++ computes them as int."""
    held = {"least": np.array(np.iinfo(dtype).min, dtype)}
    to = TensorProto.INT8 if dtype == np.int8 else TensorProto.INT16
    nodes = node("Cast", "x", "d", to=to), node(kind, "least d", "q"), node("Cast", "q", "y", to=FLOAT)
    session = load_session(graph(*nodes, held=held).SerializeToString(), "x")
    found = session.run(None, {"x": -np.ones((1, 3), np.float32)})[0]
    assert not found.any() if kind == "Mod" else (found == np.iinfo(dtype).min).all()


def einsum(equation):
    return graph(node("Einsum", "x", "y", equation=equation))


@pytest.mark.parametrize(
    "equation",
    [
        *("....", "......", "....->ba", "b....->b", "a....b->ab", "a..b->ab", "..", ". ..", "......,->"),
        *("ab->ba->ab", "ab-ba", "ab>ba", "a1->a", "ab->b\x00a", "ab\n", "\x1b[31m", "ab->,"),
    ],
)
def test_an_equation_of_einsum_is_checked_before_its_shapes_are_inferred(equation, monkeypatch):
    message = refusal(einsum(equation), monkeypatch)
    assert message.startswith(f"x.onnx: for a batch of 1: node 'y' (Einsum): equation: found {equation!r}, ")
    assert message.endswith(
        "expected terms of letters, each with at most one '...', such as '...ij,jk->...ik'"
    )


def test_an_equation_of_einsum_is_short(monkeypatch):
    message = refusal(einsum("ab," * 100 + "ab->ab"), monkeypatch)
    assert message.endswith("node 'y' (Einsum): found an equation of 306 bytes, at most 256")


def test_the_body_of_a_scan_has_its_equations_checked(monkeypatch):
    inside = body(held={"least": np.zeros(1, np.float32)})
    inside.node.append(node("Einsum", "least", "z", equation="...."))
    scan = node("Scan", "zero x", "y", body=inside, num_scan_inputs=1)
    message = refusal(graph(scan, held=ZERO, shape=("batch",)), monkeypatch)
    assert "node 'y' (Scan): node 'z' (Einsum): equation: found '....', expected terms" in message


@pytest.mark.parametrize(
    "equation", ["ab->ba", "ab -> b a", "...a->a...", "...->...", "ab", "...a", "b...->b..."]
)
def test_usual_equations_of_einsum_are_loaded(equation):
    found = load_session(einsum(equation).SerializeToString(), "x").run(None, {"x": np.eye(2, 3, dtype="f")})[
        0
    ]
    np.testing.assert_array_equal(found, np.einsum(equation.replace(" ", ""), np.eye(2, 3)))
