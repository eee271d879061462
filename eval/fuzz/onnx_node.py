"""Insertion of nodes into ONNX that mutations of single fields seldom produce."""

import numpy as np
from onnx import GraphProto, NodeProto, TensorProto, helper

EQUATION_PARTS = ("a", "b", "ab", "...", ".", "..", ",", "->", " ")
NUMBERS = (-(1 << 63), -(1 << 31), -2, -1, 0, 1, 7)
INPUTS = (1, 2, 100, 5000, 1 << 16)


def insert_node(graph: GraphProto, rng: np.random.Generator) -> None:
    """Let a tensor pass through a node: an Einsum, a division of integers, or an operator with many inputs."""
    places = [place for place, node in enumerate(graph.node) if node.output]
    if not places:
        return
    place = places[rng.integers(len(places))]
    after = graph.node[place].output[0]
    before = graph.node[place].output[0] = f"{after}_before"
    make = (_einsum, _division, _many_inputs)[rng.integers(3)]
    for node in reversed(make(before, after, rng)):
        graph.node.insert(place + 1, node)


def _einsum(before: str, after: str, rng: np.random.Generator) -> list[NodeProto]:
    equation = "".join(rng.choice(EQUATION_PARTS, size=rng.integers(1, 7)))
    return [helper.make_node("Einsum", [before] * (1 + equation.count(",")), [after], equation=equation)]


def _division(before: str, after: str, rng: np.random.Generator) -> list[NodeProto]:
    """Return a quotient whose divisor is a constant or computed."""
    kind = (TensorProto.INT32, TensorProto.INT64)[rng.integers(2)]
    names = f"{after}_dividend", f"{after}_divisor"
    nodes = []
    for name in names:
        if rng.integers(2):
            nodes.append(helper.make_node("Cast", [before], [name], to=kind))
        else:
            number = np.array(NUMBERS[rng.integers(len(NUMBERS))]).astype(
                helper.tensor_dtype_to_np_dtype(kind)
            )
            value = helper.make_tensor("number", kind, [], [number.item()])
            nodes.append(helper.make_node("Constant", [], [name], value=value))
    operator = ("Div", "Mod")[rng.integers(2)]
    nodes.append(helper.make_node(operator, names, [f"{after}_quotient"]))
    return [*nodes, helper.make_node("Cast", [f"{after}_quotient"], [after], to=TensorProto.FLOAT)]


def _many_inputs(before: str, after: str, rng: np.random.Generator) -> list[NodeProto]:
    operator = ("Sum", "Max", "Min")[rng.integers(3)]
    return [helper.make_node(operator, [before] * INPUTS[rng.integers(len(INPUTS))], [after])]
