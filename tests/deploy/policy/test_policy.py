import hashlib
import json
import struct
import subprocess
import sys

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from deploy.policy.policy import Policy
from deploy.policy.policy_names import CONTRACT_KEY, GOLDEN_KEY
from robots.errors import ContractError
from support.arm6 import SPEC
from support.contracts import NAMES, SWAPPED, arm_contract
from support.paths import ROOT
from support.policies import (
    HIDDEN,
    A,
    N,
    by_numpy,
    golden,
    loaded,
    metadata,
    policy_model,
    saved,
    tensor,
    weights,
)


@pytest.mark.parametrize("robots", [1, 2, 16, 64, 100])
def test_actions_equal_numpy(tmp_path, robots):
    policy = loaded(tmp_path)
    rng = np.random.default_rng(robots)
    for _ in range(5):
        observation = rng.normal(0, 2, (robots, N)).astype(np.float32)
        action = policy.step(observation)
        assert (action.shape, action.dtype) == ((robots, A), np.float32)
        np.testing.assert_allclose(action, by_numpy(observation, weights()), rtol=0, atol=1e-5)


def test_digest_and_contract_match_the_file(tmp_path):
    policy = loaded(tmp_path)
    assert policy.digest == hashlib.sha256((tmp_path / "policy.onnx").read_bytes()).hexdigest()
    assert policy.contract == arm_contract()


@pytest.mark.parametrize("robots", [1, 64])
def test_the_same_width_gives_the_same_bits(tmp_path, robots):
    observation = np.random.default_rng(3).normal(size=(robots, N)).astype(np.float32)
    first, second = loaded(tmp_path), loaded(tmp_path)
    bits = first.step(observation).tobytes()
    first.step(np.ones((7, N), np.float32))  # another width in between
    assert first.step(observation).tobytes() == bits
    assert second.step(np.asfortranarray(observation)).tobytes() == bits


def test_steps_write_into_the_same_buffer(tmp_path):
    policy = loaded(tmp_path)
    first = policy.step(np.zeros((4, N), np.float32))
    before = first.copy()
    assert np.shares_memory(first, policy.step(np.ones((4, N), np.float32)))
    assert not np.array_equal(first, before)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_bad_observation_stays_in_its_row(tmp_path, bad):
    policy = loaded(tmp_path)
    observation = np.random.default_rng(4).normal(size=(64, N)).astype(np.float32)
    expected = policy.step(observation).copy()
    observation[[5, 40], [0, 23]] = bad
    action = policy.step(observation)
    others = np.delete(np.arange(64), [5, 40])
    assert action[others].tobytes() == expected[others].tobytes()
    assert not np.isfinite(action[[5, 40]]).any()


@pytest.mark.parametrize("shape", [(N,), (1, N - 1), (0, N), (1, 1), (2, 2, N)])
def test_an_observation_of_another_shape_is_refused(tmp_path, shape):
    policy = loaded(tmp_path)
    with pytest.raises(ContractError) as caught:
        policy.step(np.zeros(shape, np.float32))
    assert str(caught.value).endswith(f"policy.onnx: observation: found shape {shape}, expected (B, 30)")


def test_replay_pads_the_last_batch(tmp_path):
    policy = loaded(tmp_path)
    observation = np.random.default_rng(5).normal(size=(70, N)).astype(np.float32)
    one = np.concatenate([policy.step(row[None]).copy() for row in observation])
    for batch in (1, 64, 200):
        np.testing.assert_allclose(policy.replay(observation, batch), one, rtol=0, atol=1e-5)


def test_loading_needs_no_torch():
    code = "import sys, deploy.policy.policy; sys.exit('torch' in sys.modules)"
    root = ROOT
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0


# ---- files that are no policy ----

NOT_ONNX = {
    "empty": (b"", "not a valid ONNX model"),
    "text": (b"#!/bin/sh\nrm -rf /\n" * 9, "not an ONNX file: its 171 bytes cannot be decoded"),
    "zeros": (bytes(1000), "not an ONNX file: its 1000 bytes cannot be decoded"),
    "bytes for names": (
        policy_model().SerializeToString().replace(b"Gemm", b"G\x81mm"),
        "not a valid ONNX model",
    ),
    "cut": (policy_model().SerializeToString()[:-100], "not an ONNX file"),
}


@pytest.mark.parametrize(("data", "message"), NOT_ONNX.values(), ids=NOT_ONNX)
def test_non_onnx_file_is_refused(tmp_path, data, message):
    path = tmp_path / "x.onnx"
    path.write_bytes(data)
    with pytest.raises(ContractError) as caught:
        Policy.load(path, SPEC)
    assert str(caught.value).startswith(f"{path}: {message}")


@pytest.mark.parametrize(("name", "why"), [("no.onnx", "No such file or directory"), ("", "Is a directory")])
def test_an_unreadable_file_is_refused(tmp_path, name, why):
    with pytest.raises(ContractError) as caught:
        Policy.load(tmp_path / name, SPEC)
    assert str(caught.value) == f"{tmp_path / name}: cannot be read: {why}, expected an ONNX policy"


def test_oversized_file_is_not_read(tmp_path):
    path = tmp_path / "x.onnx"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(ContractError, match=f"x.onnx: found {1 << 40} bytes, at most {256 << 20}"):
        Policy.load(path, SPEC)


# ---- policies that are not what they promise ----


def nan_weight(model):
    array = numpy_helper.to_array(tensor(model, "w0")).copy()
    array[3, 4] = np.nan
    tensor(model, "w0").CopyFrom(numpy_helper.from_array(array, "w0"))


def infinite_weight(model):
    raw = bytearray(tensor(model, "b1").raw_data)
    raw[:8] = struct.pack("<ff", np.inf, -np.inf)
    tensor(model, "b1").raw_data = bytes(raw)


def nan_constant(model):
    value = numpy_helper.from_array(np.full(A, np.nan, np.float32), "hidden")
    model.graph.node[-1].output[0] = "a"
    model.graph.node.append(helper.make_node("Constant", [], ["c"], value=value))
    model.graph.node.append(helper.make_node("Add", ["a", "c"], ["action"]))


def changed_weight(model):
    array = numpy_helper.to_array(tensor(model, "b1")).copy()
    array[2] += 1e-3
    tensor(model, "b1").CopyFrom(numpy_helper.from_array(array, "b1"))


def external(model):
    w0 = tensor(model, "w0")
    w0.ClearField("raw_data")
    w0.data_location = TensorProto.EXTERNAL
    w0.external_data.add(key="location", value="/etc/passwd")


def foreign_domain(model):
    model.opset_import.append(helper.make_opsetid("com.microsoft", 1))


def foreign_node(model):
    model.graph.node[1].domain = "evil"


def unknown_operator(model):
    model.graph.node[1].op_type = "Elu2"


def function(model):
    body = [helper.make_node("Elu", ["x"], ["y"])]
    model.functions.append(helper.make_function("", "F", ["x"], ["y"], body, [helper.make_opsetid("", 18)]))


def control_flow(model):
    body = helper.make_graph([], "forever", [], [])
    model.graph.node.append(helper.make_node("Loop", ["", ""], ["x"], name="spin", body=body))


def escapes(model):
    model.graph.node[1].op_type = "\x1b[2J"


def cut_tensor(model):
    tensor(model, "w0").raw_data = tensor(model, "w0").raw_data[:-4]


def fixed_batch(model):
    model.graph.input[0].type.tensor_type.shape.dim[0].dim_value = 1


def secretly_fixed_batch(model):
    model.graph.node[-1].output[0] = "a"
    model.graph.initializer.append(numpy_helper.from_array(np.array([1, A]), "shape"))
    model.graph.node.append(helper.make_node("Reshape", ["a", "shape"], ["action"]))


def other_dtype(model):
    model.graph.input[0].type.tensor_type.elem_type = TensorProto.DOUBLE


def unknown_dtype(model):
    model.graph.input[0].type.tensor_type.elem_type = 99


def unknown_weights(model):
    tensor(model, "w0").data_type = 99


def other_width(model):
    model.graph.input[0].type.tensor_type.shape.dim[1].dim_value = 23


def no_type(model):
    model.graph.output[0].type.Clear()


def renamed_input(model):
    model.graph.input[0].name = model.graph.node[0].input[0] = "obs"


def second_output(model):
    model.graph.output.append(helper.make_tensor_value_info("h", TensorProto.FLOAT, ["batch", HIDDEN]))


def second_input(model):
    model.graph.input.append(helper.make_tensor_value_info("t", TensorProto.FLOAT, ["batch", 1]))


def no_contract(model):
    model.metadata_props.remove(metadata(model, CONTRACT_KEY))


def no_metadata(model):
    del model.metadata_props[:]


def broken_contract(model):
    metadata(model, CONTRACT_KEY).value = "{"


def no_golden(model):
    model.metadata_props.remove(metadata(model, GOLDEN_KEY))


def golden_edit(change):
    def edit(model):
        data = golden(weights())
        change(data)
        metadata(model, GOLDEN_KEY).value = json.dumps(data)

    return edit


def contract_edit(**changes):
    def edit(model):
        metadata(model, CONTRACT_KEY).value = arm_contract(**changes).to_json()

    return edit


ONE_INPUT = "expected one, 'observation' float32 (batch, 30) with a batch of any size"
ONE_OUTPUT = "expected one, 'action' float32 (batch, 6) with a batch of any size"
BAD_POLICIES = [
    (nan_weight, "tensor 'w0': found 1 of 960 weights NaN or infinite, expected all finite"),
    (infinite_weight, "tensor 'b1': found 2 of 6 weights NaN or infinite, expected all finite"),
    (nan_constant, "tensor 'hidden': found 6 of 6 weights NaN or infinite, expected all finite"),
    (changed_weight, "golden pairs: found a deviation of 0.001 at batch 1, expected at most 1e-05"),
    (external, "tensor 'w0': found external data, expected all weights in the one file"),
    (foreign_domain, "operator domain: found 'com.microsoft', expected only ai.onnx"),
    (foreign_node, "operator domain: found 'evil', expected only ai.onnx"),
    (unknown_operator, "not a valid ONNX model: No Op registered for Elu2"),
    (function, "found functions, expected plain nodes"),
    (control_flow, "node 'spin': found Loop with a graph of its own, expected none"),
    (escapes, "not a valid ONNX model: No Op registered for ?[2J"),
    (cut_tensor, "not a valid ONNX model: "),
    (fixed_batch, f"input 'observation': found FLOAT [1, 30], {ONE_INPUT}"),
    (secretly_fixed_batch, "cannot be run at batch 64: "),
    (other_dtype, f"input 'observation': found DOUBLE ['batch', 30], {ONE_INPUT}"),
    (unknown_dtype, f"input 'observation': found kind 99 ['batch', 30], {ONE_INPUT}"),
    (unknown_weights, "tensor 'w0': cannot be read: "),
    (other_width, f"input 'observation': found FLOAT ['batch', 23], {ONE_INPUT}"),
    (no_type, "not a valid ONNX model: "),
    (renamed_input, f"input: found ['obs'], {ONE_INPUT}"),
    (second_input, f"input: found ['observation', 't'], {ONE_INPUT}"),
    (second_output, f"output: found ['action', 'h'], {ONE_OUTPUT}"),
    (
        no_contract,
        f"metadata {CONTRACT_KEY}: missing, found keys: {GOLDEN_KEY!r}; expected a file written by",
    ),
    (no_metadata, f"metadata {CONTRACT_KEY}: missing, found keys: none; expected a file written by"),
    (broken_contract, f"{CONTRACT_KEY}: not valid JSON: "),
    (no_golden, f"metadata {GOLDEN_KEY}: missing, found keys: {CONTRACT_KEY!r}; expected a file written by"),
    (golden_edit(lambda d: d.clear()), f"{GOLDEN_KEY}: observation: Field required"),
    (
        golden_edit(lambda d: d["action"].pop()),
        f"{GOLDEN_KEY}: 16 observations but 15",
    ),
    (
        golden_edit(lambda d: d["action"][3].pop()),
        f"{GOLDEN_KEY}: action: found a row of 5 numbers, expected 6",
    ),
    (
        golden_edit(lambda d: d["observation"][3].append(0.0)),
        f"{GOLDEN_KEY}: observation: found a row of 31 numbers, expected 30",
    ),
    (
        golden_edit(lambda d: d["action"][3].__setitem__(0, float("nan"))),
        f"{GOLDEN_KEY}: action.3.0: Input should be a finite number, found nan",
    ),
    (
        golden_edit(lambda d: d["action"][15].__setitem__(0, -4e38)),
        f"{GOLDEN_KEY}: action.15.0: found -4e+38, expected at most 3.40282e+38 either way: single precision",
    ),
    (
        golden_edit(lambda d: d["action"][15].__setitem__(0, 1e3)),
        "golden pairs: found a deviation of 999 at batch 1, expected at most 1e-05",
    ),
    (contract_edit(robot="planar3"), "contract: robot: found 'planar3', expected 'arm6'"),
    (
        contract_edit(robot_digest="0" * 64),
        f"contract: robot_digest: found {'0' * 64}, expected {SPEC.digest}",
    ),
    (contract_edit(control_hz=400), "contract: control_hz: found 400 Hz, expected 200 Hz"),
    (
        contract_edit(joint_names=SWAPPED),
        "contract: joint_names: the right joints in another order: "
        f"found [{', '.join(SWAPPED)}], expected [{', '.join(NAMES)}]",
    ),
]


@pytest.mark.parametrize(("edit", "message"), BAD_POLICIES, ids=lambda x: getattr(x, "__name__", None))
def test_a_bad_policy_is_refused_at_load(tmp_path, edit, message):
    model = policy_model()
    edit(model)
    path = saved(model, tmp_path)
    with pytest.raises(ContractError) as caught:
        Policy.load(path, SPEC)
    assert str(caught.value).startswith(f"{path}: {message}")
    assert len(str(caught.value)) < 1000


def looked_up(model, table, *nodes):
    """Add to the actions a number that the number of robots chooses from a table, after some nodes."""
    model.graph.node[-1].output[0] = "a"
    model.graph.initializer.append(numpy_helper.from_array(np.array(table), "table"))
    shape = helper.make_node("Shape", ["observation"], ["robots"], start=0, end=1)
    found = helper.make_node("Gather", ["table", "robots"], ["found"])
    model.graph.node.extend([shape, found, *nodes, helper.make_node("Add", ["a", "more"], ["action"])])


def test_a_policy_that_is_large_for_some_number_of_robots_is_not_run_for_so_many(tmp_path):
    """It is tried for 1 and for 64."""
    model, sizes = policy_model(), np.ones(65, np.int64)
    sizes[8] = 1 << 40
    zeros = helper.make_node("ConstantOfShape", ["found"], ["zeros"])
    looked_up(model, sizes, zeros, helper.make_node("ReduceSum", ["zeros"], ["more"], keepdims=0))
    policy, observation = loaded(tmp_path, model), np.ones((8, N), np.float32)
    for run in (policy.step, lambda rows: policy.replay(rows, 8), lambda _: policy.resize(8)):
        with pytest.raises(
            ContractError, match=r"policy\.onnx: for a batch of 8: node 'zeros'.*: found 1099511627"
        ):
            run(observation)
    np.testing.assert_allclose(policy.step(observation[:7]), by_numpy(observation[:7], weights()), atol=1e-5)


def test_a_policy_that_fails_for_some_number_of_robots_is_named(tmp_path):
    model, entries = policy_model(), np.zeros(65, np.float32)
    looked_up(model, entries, helper.make_node("Identity", ["found"], ["more"]))
    policy, observation = loaded(tmp_path, model), np.ones((66, N), np.float32)
    for run in (policy.replay, policy.rehearse):
        with pytest.raises(
            ContractError, match=r"policy\.onnx: cannot be run at batch 66: .*out of data bounds"
        ):
            run(observation, 66)


def test_weights_of_every_float_type_are_checked(tmp_path):
    for dtype in (np.float16, np.float64):
        model = policy_model()
        model.graph.initializer.append(numpy_helper.from_array(np.array([1, np.inf], dtype), "extra"))
        with pytest.raises(ContractError, match="tensor 'extra': found 1 of 2 weights"):
            loaded(tmp_path, model)


def test_the_model_under_test_is_valid(tmp_path):
    onnx.checker.check_model(policy_model(), full_check=True)
