import os
import signal
import subprocess
import sys

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from functools import partial

from torch import nn

from policies.importers.readers import read_policy
from policies.importers.torch_files.network_settings import NetworkSettings
from policies.importers.torch_files.operators import OPERATORS, is_operator
from policies.importers.torch_files.torchscript import read_torchscript
from policies.importers.torch_files.torchscript_check import REFUSED, check_source
from robots.errors import ContractError
from support.importers.parity import parity
from support.importers.torch_files import HIDDEN, A, N, Recurrent, changed, members, mlp, saved_script
from support.paths import ROOT, SHARED
from support.refusals import refusal

pytestmark = pytest.mark.slow

H1 = SHARED / "peers" / "h1" / "motion.pt"


class Attribute(nn.Module):
    def __init__(self):
        super().__init__()
        self.layer = nn.Linear(N, A)
        self.state = torch.zeros(1, A)

    def forward(self, x):
        self.state = torch.tanh(self.layer(x) + self.state)
        return self.state


class Hidden(Attribute):
    def forward(self, x):
        self.state.copy_(torch.tanh(self.layer(x) + self.state))
        return self.state.clone()


refused = partial(refusal, read_torchscript)


# ---- policies ----


def test_a_scripted_network_is_reproduced_and_a_spoiled_weight_breaks_parity(tmp_path):
    original = read_torchscript(saved_script(tmp_path / "policy.pt", mlp()))
    assert (original.facts.kind, original.facts.observations, original.facts.actions) == ("TorchScript", N, A)
    assert original.batched
    assert parity(original) <= 1e-5
    original.model.graph.initializer[0].raw_data = bytes(len(original.model.graph.initializer[0].raw_data))
    with pytest.raises(ContractError, match="weights or a normalizer differ"):
        parity(original)


def test_memory_in_buffers_becomes_an_input(tmp_path):
    torch.manual_seed(1)
    original = read_torchscript(saved_script(tmp_path / "policy.pt", Recurrent().eval()))
    assert original.facts.observations == N
    assert [memory.shape for memory in original.memory] == [(1, 1, HIDDEN)] * 2
    assert parity(original) <= 1e-5


@pytest.mark.parametrize("kind", ["MLPModel", "RNNModel"])
def test_export_of_rsl_rl_is_reproduced_with_its_normalizer(tmp_path, kind):
    models = pytest.importorskip("rsl_rl.models")
    tensordict = pytest.importorskip("tensordict")
    torch.manual_seed(2)
    groups = {"actor": ["policy"]}
    observation = tensordict.TensorDict({"policy": torch.randn(64, N) * 3 + 1}, batch_size=[64])
    more = {"rnn_hidden_dim": HIDDEN} if kind == "RNNModel" else {}
    model = getattr(models, kind)(
        observation, groups, "actor", A, hidden_dims=(16,), obs_normalization=True, **more
    )
    model.update_normalization(observation)
    original = read_torchscript(saved_script(tmp_path / "policy.pt", model.eval().as_jit()))
    assert (original.facts.observations, original.facts.actions) == (N, A)
    assert original.memory_size == (2 * HIDDEN if more else 0)
    assert parity(original) <= 1e-5


@pytest.mark.parametrize("make", [lambda m: torch.jit.trace(m, torch.zeros(1, N)), "freeze"])
def test_traced_and_frozen_networks_are_loaded(tmp_path, make):
    make = (lambda m: torch.jit.freeze(torch.jit.script(m))) if make == "freeze" else make
    original = read_torchscript(saved_script(tmp_path / "policy.pt", mlp(), make))
    observation = torch.randn(1, N)
    found = original.run(observation.numpy(), torch.ones(1, dtype=torch.bool).numpy())
    torch.testing.assert_close(torch.from_numpy(found), mlp()(observation).detach(), rtol=0, atol=1e-6)


@pytest.mark.skipif(not H1.exists(), reason="no policy of Unitree's beside this project")
def test_unitrees_walking_policy_is_reproduced():
    original = read_torchscript(H1)
    assert (original.facts.observations, original.facts.actions, original.memory_size) == (41, 10, 128)
    assert parity(original) <= 1e-5


def test_a_memory_outside_the_buffers_is_refused(tmp_path):
    message = refused(saved_script(tmp_path / "policy.pt", Attribute()))
    assert message == "state: found state (Tensor) in an attribute, expected it in a buffer"


def test_hidden_memory_is_found_by_tracing(tmp_path):
    """Torch does not let a graph write into a tensor that is neither its own nor given."""
    assert refused(saved_script(tmp_path / "policy.pt", Hidden())).startswith("cannot be run or traced: ")


# ---- files that would do more ----


def test_every_operator_that_is_given_a_file_is_refused():
    given = {
        schema.name.removeprefix("aten::")
        for schema in torch._C._jit_get_all_schemas()
        if schema.name.startswith("aten::")
        for argument in schema.arguments
        if str(argument.type) == "str"
        and any(word in argument.name for word in ("file", "path", "dir", "url"))
    }
    assert given == REFUSED - {"classes"}
    assert not any(map(is_operator, given))


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("torch.save(x, 'out')", "torch.save"),
        ("(x).save('out')", "x.save"),
        ("('out').from_file()", "'out'.from_file"),
        ("getattr(x, 'save')('out')", "'save'"),
        ("t = torch", "torch"),
        ("ops.quantized.add(x, x, 1., 0)", "ops.quantized"),
        ("p = ops.prim", "ops.prim"),
        ("ops.prim.rpc_sync('w', x)", "ops.prim.rpc_sync"),
        ("fork(x)", "fork"),
        ("print(x)", "print"),
        ("torch.load('in')", "torch.load"),
        ("__torch__.torch.classes.profiler.Profiler()", "__torch__.torch.classes"),
        ("torch._sparse_coo_tensor_unsafe(x, x, [6])", "torch._sparse_coo_tensor_unsafe"),
        ("torch.as_strided(x, [9], [1])", "torch.as_strided"),
        ("torch.set_(x, x)", "torch.set_"),
    ],
)
def test_operators_beyond_tensors_are_named(line, found):
    text = f"def forward(self: Tensor,\n    x: Tensor) -> Tensor:\n  {line}\n  return x\n"
    with pytest.raises(ContractError) as caught:
        check_source(text.encode(), "f.py")
    assert str(caught.value).startswith(f"f.py: line 3: found {found}")


@pytest.mark.parametrize(
    "word", ["sparse", "_coo", "_csr", "nested", "set_", "resize", "quantize", "ptr", "cudnn"]
)
def test_no_operator_beyond_plain_tensors_is_allowed(word):
    assert not [name for name in OPERATORS if word in name and not name.startswith("_set_item")]


def test_operators_called_as_methods_are_found_in_the_graph(tmp_path):
    path = saved_script(tmp_path / "policy.pt", mlp())
    (code,) = (name for name in members(path) if "container" in name and name.endswith(".py"))
    line = b"    return torch.add((input).as_strided([7], [1], 1000000), 1)\n"

    def spoiled(text):
        head, _, _ = text.partition(b"  def forward")
        return (
            head
            + b"  def forward(self: __torch__.torch.nn.modules.container.Sequential,\n"
            + (b"    input: Tensor) -> Tensor:\n" + line)
        )

    message = refused(changed(path, code.partition("/")[2], spoiled))
    assert message.startswith("found operator aten::as_strided, expected only operators of policy networks")


NESTED, LEVELS = 12, 90
"""Methods that call each other, and the branches inside each: Python's parser reads 99 levels."""


def nested(k):
    """A method that calls the next one from the innermost of its branches; the last one sets a tensor's storage."""
    call = f"(self).f{k + 1}(x, )" if k + 1 < NESTED else "(x).as_strided([7], [1], 1000000)"
    branches = [f"{' ' * level}if torch.eq(torch.len(x), 1):" for level in range(4, 4 + LEVELS)]
    head = f"  def f{k}(self: __torch__.torch.nn.modules.container.Sequential, x: Tensor) -> Tensor:"
    lines = head, "    y = x", *branches, f"{' ' * (4 + LEVELS)}y = {call}", "    return y"
    return "\n".join(lines) + "\n"


def test_operators_are_found_however_deep_a_graph_is_nested(tmp_path):
    path = saved_script(tmp_path / "policy.pt", mlp())
    (code,) = (name for name in members(path) if "container" in name and name.endswith(".py"))

    def spoiled(text):
        return (
            text.replace(b"(input, )", b"((self).f0(input, ), )", 1)
            + "".join(map(nested, range(NESTED))).encode()
        )

    message = refused(changed(path, code.partition("/")[2], spoiled))
    assert message.startswith("found operator aten::as_strided, expected only operators of policy networks")


def test_a_long_chain_of_attributes_is_checked():
    text = f"def forward(self: Tensor) -> Tensor:\n  return self{'.l' * 900}"
    check_source(text.encode(), "f.py")
    with pytest.raises(ContractError, match=r"f\.py: line 3: found torch\.save"):
        check_source(f"{text}\n  torch.save(self)".encode(), "f.py")


@pytest.mark.parametrize(
    "layer",
    [
        nn.Softmax(-1),
        nn.LayerNorm(N),
        nn.BatchNorm1d(N),
        nn.GELU(),
        nn.Sequential(
            nn.Unflatten(1, (1, N)), nn.Conv1d(1, 2, 3), nn.MaxPool1d(2), nn.Flatten(), nn.Linear(4, N)
        ),
    ],
    ids=lambda layer: type(layer).__name__,
)
def test_usual_layers_are_read(tmp_path, layer):
    module = nn.Sequential(nn.Linear(N, N), layer, nn.Linear(N, A)).eval()
    assert read_torchscript(saved_script(tmp_path / "policy.pt", module)).facts.actions == A


def test_calls_that_double_the_graph_end_the_process(tmp_path):
    path = tmp_path / "policy.pt"
    methods = "".join(
        f"  def f{k + 1}(self, x: torch.Tensor):\n    return self.f{k}(self.f{k}(x))\n" for k in range(40)
    )
    made = (
        "import torch\nclass Doubled(torch.nn.Module):\n"
        "  def forward(self, x: torch.Tensor):\n    return self.f40(x)\n"
        f"  def f0(self, x: torch.Tensor):\n    return x + 1\n{methods}"
    )
    (tmp_path / "doubled.py").write_text(made)
    load = (
        "import doubled, sys, torch, warnings; from pathlib import Path; warnings.simplefilter('ignore')\n"
        "from policies.importers.torch_files import torchscript\n"
        "torchscript.LOAD_CPU_S = 1\n"
        "torch.jit.save(torch.jit.script(doubled.Doubled()), sys.argv[1])\n"
        "torchscript.read_torchscript(Path(sys.argv[1]))\n"
    )
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{tmp_path}"}
    done = subprocess.run([sys.executable, "-c", load, str(path)], env=environment, timeout=100, check=False)
    assert done.returncode == -signal.SIGXCPU


def test_code_that_runs_at_loading_is_refused_before_loading(tmp_path):
    witness = tmp_path / "witness"

    path = saved_script(tmp_path / "policy.pt", mlp())
    (code,) = (name for name in members(path) if "container" in name and name.endswith(".py"))
    evil = f"\n  def __setstate__(self, s: int) -> NoneType:\n    torch.save(1, {str(witness)!r})\n    return None\n"
    message = refused(changed(path, code.partition("/")[2], lambda text: text + evil.encode()))
    assert "found __setstate__, expected" in message
    assert not witness.exists()


@pytest.mark.parametrize("name", ["__forward_hooks__", "__forward_pre_hooks__"])
def test_methods_that_run_around_forward_are_refused(tmp_path, name):
    """They are not in its graph, whose operators are checked."""
    path = saved_script(tmp_path / "policy.pt", mlp())
    (code,) = (
        name
        for name in members(path)
        if name.endswith(".py") and b"forward(self" in members(path)[name] and "container" in name
    )
    message = refused(
        changed(path, code.partition("/")[2], lambda text: text + f'\n  {name} = ["forward"]\n'.encode())
    )
    assert f"found {name}, expected" in message


def test_a_tensor_that_claims_more_bytes_than_it_has_is_refused(tmp_path):
    path = changed(saved_script(tmp_path / "policy.pt", mlp()), "data/0", lambda data: data[:8])
    assert refused(path).startswith("data.pkl: tensor 0: found 8 bytes, expected ")


def test_a_buffer_that_claims_more_than_a_file_may_have_is_refused(tmp_path):
    """Its 10^12 numbers are one."""
    module = mlp()
    module.register_buffer("vast", torch.zeros(1).expand(10**12))
    assert refused(saved_script(tmp_path / "policy.pt", module)) == (
        "'vast': found 4000000000000 bytes, and 4000000000716 in all parameters and buffers, expected at most 268435456"
    )


def test_code_that_torch_does_not_compile_is_refused(tmp_path):
    path = saved_script(tmp_path / "policy.pt", mlp())
    (code,) = (name for name in members(path) if "container" in name and name.endswith(".py"))
    changed(path, code.partition("/")[2], lambda text: text.replace(b"(input, )", b"(input.l, )", 1))
    message = refusal(partial(read_policy, network=NetworkSettings()), path)
    assert message.startswith("cannot be read: RuntimeError: ")


def test_a_foreign_class_in_the_pickle_is_refused(tmp_path):
    def spoiled(data):
        return data.replace(b"collections\nOrderedDict", b"posix\nsystem")

    message = refused(changed(saved_script(tmp_path / "policy.pt", mlp()), "data.pkl", spoiled))
    assert message.startswith("data.pkl: found 'posix system', expected only the file's own classes")


def test_foreign_files_are_refused_in_one_line(tmp_path):
    path = tmp_path / "policy.pt"
    path.write_bytes(b"no zip")
    assert refused(path).startswith("found no archive that can be read")
    torch.save({"a": torch.zeros(1)}, path)
    assert refused(path).startswith("found no data.pkl and constants.pkl")
    assert refused(tmp_path / "none.pt").startswith("cannot be read: No such file")


def test_a_network_that_runs_with_no_size_of_its_weights_is_refused(tmp_path):
    class Images(nn.Module):
        def __init__(self):
            super().__init__()
            self.layer = nn.Linear(N, A)

        def forward(self, x):
            return self.layer(x.view(1, 2, self.layer.in_features).sum(1))

    assert refused(saved_script(tmp_path / "policy.pt", Images())).endswith(
        f"any observation size of its weights: [{N}]"
    )
