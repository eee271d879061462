import json
import zipfile

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from functools import partial

from torch import nn

from policies.importers.readers import read_policy
from policies.importers.torch_files.exported_program import read_exported_program
from policies.importers.torch_files.network_settings import NetworkSettings
from robots.errors import ContractError
from support.importers.exported_programs import saved
from support.importers.parity import parity
from support.importers.torch_files import HIDDEN, A, N, changed
from support.refusals import refusal

pytestmark = pytest.mark.slow

PROGRAM, WEIGHTS = "models/model.json", "data/weights/model_weights_config.json"


class Recurrent(nn.Module):
    def __init__(self):
        super().__init__()
        self.cell = nn.LSTMCell(N, HIDDEN)
        self.head = nn.Linear(HIDDEN, A)
        self.register_buffer("hidden", torch.zeros(1, HIDDEN))
        self.register_buffer("inner", torch.zeros(1, HIDDEN))

    def forward(self, x):
        hidden, inner = self.cell(x, (self.hidden, self.inner))
        self.hidden.copy_(hidden)
        self.inner.copy_(inner)
        return self.head(hidden)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The bytes of a plain network's file."""
    return saved(tmp_path_factory.mktemp("plain")).read_bytes()


def spoiled(folder, data, name, change):
    """The same file but for its JSON under a name."""
    path = folder / "policy.pt2"
    path.write_bytes(data)

    def changed_text(text):
        found = json.loads(text)
        change(found)
        return json.dumps(found).encode()

    return changed(path, name, changed_text)


refused = partial(refusal, read_exported_program)


def first_node(program):
    return program["graph_module"]["graph"]["nodes"][0]


# ---- policies ----


def test_a_program_for_any_batch_is_reproduced_and_a_spoiled_weight_breaks_parity(tmp_path):
    any_batch = {"dynamic_shapes": ({0: torch.export.Dim("batch", min=1, max=4096)},)}
    original = read_exported_program(saved(tmp_path, batch=2, **any_batch))
    assert (original.facts.observations, original.facts.actions, original.batched) == (N, A, True)
    assert parity(original) <= 1e-5
    weight = original.model.graph.initializer[0]
    weight.raw_data = bytes(len(weight.raw_data))
    with pytest.raises(ContractError, match="weights or a normalizer differ"):
        parity(original)


def test_changed_buffers_become_the_memory(tmp_path):
    torch.manual_seed(1)
    original = read_exported_program(saved(tmp_path, Recurrent().eval()))
    assert [memory.shape for memory in original.memory] == [(1, HIDDEN)] * 2
    assert parity(original) <= 1e-5


def test_a_program_for_four_robots_at_once_is_refused(tmp_path):
    found = refused(saved(tmp_path, batch=4))
    assert found.startswith(f"found observations of shape (4, {N}), expected a batch of 1 or of any size")


# ---- files that would do more ----


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda p: first_node(p).update(target="torch.load"),
            "target: found 'torch.load', expected operators",
        ),
        (
            lambda p: first_node(p).update(target="torch.ops.aten.from_file.default"),
            "target: found 'torch.ops.aten.from_file.default', expected operators of policy",
        ),
        (
            lambda p: first_node(p).update(target="torch.ops.aten._sparse_coo_tensor_unsafe.default"),
            "target: found 'torch.ops.aten._sparse_coo_tensor_unsafe.default', expected operators of policy",
        ),
        (
            lambda p: first_node(p).update(name="x=print(1)"),
            "name: found 'x=print(1)', expected a plain word",
        ),
        (
            lambda p: first_node(p).update(name="torch.relu"),
            "name: found 'torch.relu', expected a plain word",
        ),
        (
            lambda p: first_node(p)["inputs"][0].update(
                arg={"as_custom_obj": {"name": "x", "class_fqn": "y"}}
            ),
            "arg: found 'as_custom_obj', expected only tensors and numbers",
        ),
        (
            lambda p: p["graph_module"]["graph"]["tensor_values"]["input"]["sizes"].insert(
                0, {"as_expr": {"expr_str": "__import__('os').mkdir('x')", "hint": None}}
            ),
            "expr_str: found ",
        ),
        (
            lambda p: p["graph_module"]["module_call_graph"][0]["signature"].update(in_spec="[1, {}]"),
            "in_spec: found '[1, {}]', expected one tensor of observations and one of actions",
        ),
        (lambda p: p["range_constraints"].update(u999999999={}), "range_constraints: found 'u999999999'"),
        (lambda p: p.pop("graph_module"), "found no exported program: a KeyError"),
    ],
)
def test_program_beyond_arithmetic_is_refused(tmp_path, plain, change, message):
    assert refused(spoiled(tmp_path, plain, PROGRAM, change)).startswith(f"{PROGRAM}: {message}")


def name_first_call(program):
    program["graph_module"]["module_call_graph"][0]["fqn"] = "0"


def drop_signature(program):
    program["graph_module"]["module_call_graph"][0]["signature"] = None


def drop_nodes(program):
    program["graph_module"]["graph"]["nodes"].clear()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (name_first_call, "AssertionError: "),
        (drop_signature, "AttributeError: "),
        (drop_nodes, "KeyError: "),
    ],
)
def test_program_that_torch_cannot_build_is_refused(tmp_path, plain, change, message):
    found = refusal(
        partial(read_policy, network=NetworkSettings()), spoiled(tmp_path, plain, PROGRAM, change)
    )
    assert found.startswith(f"cannot be read: {message}")


def test_a_number_in_place_of_observations_is_refused(tmp_path, plain):
    def change(program):
        graph = program["graph_module"]["graph"]
        graph["inputs"][-1] = {"as_sym_int": {"as_name": "input"}}
        graph["sym_int_values"] = {"input": {"as_int": 3}}

    found = refused(spoiled(tmp_path, plain, PROGRAM, change))
    assert found == "found inputs of shapes [()], expected (batch, observations)"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"use_pickle": True}, "0.weight: found a pickle, expected plain numbers"),
        ({"path_name": "../weight_0"}, "path_name: found '../weight_0', expected a plain word"),
        ({"path_name": "weight_9"}, "0.weight: found 'weight_9', which is none of the tensors in the file"),
        (
            {"tensor_meta": {"sizes": [{"as_int": 1 << 40}]}},
            "0.weight: found 448 bytes, expected all numbers",
        ),
    ],
)
def test_weights_other_than_plain_tensors_are_refused(tmp_path, plain, change, message):
    found = refused(spoiled(tmp_path, plain, WEIGHTS, lambda w: w["config"]["0.weight"].update(change)))
    assert found.startswith(f"{WEIGHTS}: {message}")


def test_guards_examples_and_libraries_never_reach_torch(tmp_path, plain):
    witness = tmp_path / "witness"
    guard = f"__import__('os').mkdir({str(witness)!r})"
    path = spoiled(tmp_path, plain, PROGRAM, lambda program: program.update(guards_code=[guard]))
    changed(path, "data/sample_inputs/model.pt", lambda _: b"cos\nmkdir\n.")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("policy/data/aotinductor/model/evil.so", b"\x7fELF")
    assert read_exported_program(path).facts.observations == N
    assert not witness.exists()


def test_foreign_files_are_refused_in_one_line(tmp_path):
    path = tmp_path / "policy.pt2"
    path.write_bytes(b"no zip")
    assert refused(path).startswith("found no archive that can be read")
    torch.save({"a": torch.zeros(1)}, path)
    assert refused(path) == "found no models/model.json, expected a file of torch.export.save"
