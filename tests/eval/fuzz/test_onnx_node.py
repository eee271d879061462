"""Nodes that the fuzzer inserts reach what once crashed, hung or took a minute."""

import numpy as np
import onnx
import pytest

from eval.fuzz.onnx_model import mutate_onnx
from eval.fuzz.onnx_node import insert_node
from support.policies import policy_model

KINDS = {"Einsum", "Div", "Mod", "Sum", "Max", "Min"}


def inserted(seed):
    model = policy_model()
    insert_node(model.graph, np.random.default_rng(seed))
    return model


@pytest.fixture(scope="module")
def models():
    return [inserted(seed) for seed in range(300)]


def test_inserted_nodes_are_valid_and_computed(models):
    for model in models:
        onnx.checker.check_model(model)
        assert {"observation", "action"} <= {
            name for node in model.graph.node for name in (*node.input, *node.output)
        }


def test_each_kind_of_node_is_inserted(models):
    nodes = [node for model in models for node in model.graph.node]
    assert {node.op_type for node in nodes} >= KINDS
    assert max(len(node.input) for node in nodes) == 1 << 16
    equations = [
        attribute.s for node in nodes for attribute in node.attribute if attribute.name == "equation"
    ]
    assert any(b"...." in equation for equation in equations)


def test_an_inserted_node_is_one_of_the_mutations():
    data = policy_model().SerializeToString()
    mutations = [mutate_onnx(data, np.random.default_rng(seed)) for seed in range(50)]
    assert sum(b"_before" in mutation for mutation in mutations) in range(5, 20)


def test_a_graph_without_outputs_of_nodes_stays():
    model = policy_model()
    del model.graph.node[:]
    before = model.SerializeToString()
    insert_node(model.graph, np.random.default_rng(0))
    assert model.SerializeToString() == before
