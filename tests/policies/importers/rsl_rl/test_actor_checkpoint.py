"""Checkpoints that rsl_rl itself wrote.

Those of version 5 are saved here, by its runner. The three files beside this one were saved by the runners of versions
2.3.3, 3.1.2 and 4.0.1 after one iteration on noise; their `infos` hold 40 observations in a row, of one robot from its
reset on, and what the policy of that same version answered.
"""

import os

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("rsl_rl")
pytest.importorskip("onnxscript")

from onnx import numpy_helper

from policies.importers.reference_policy import MissingSettingError
from policies.importers.rsl_rl.actor import Actor
from policies.importers.rsl_rl.actor_checkpoint import read_rsl_rl
from policies.importers.torch_files.network_settings import NetworkSettings
from robots.errors import ContractError
from support.importers.parity import parity
from support.importers.rsl_rl_files import KINDS, A, Env, N, saved
from support.paths import DATA
from support.refusals import refusal

pytestmark = pytest.mark.slow

ELU = NetworkSettings(activation="elu")


def spoil(original, change):
    """Change each weight of its graph in place."""
    for tensor in original.model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.size > 1:
            tensor.CopyFrom(numpy_helper.from_array(change(values), tensor.name))


@pytest.mark.parametrize("kind", KINDS)
def test_imported_file_equals_rsl_rl(tmp_path, kind):
    path, model = saved(tmp_path, **KINDS[kind])
    plain = kind == "GRU"
    original = read_rsl_rl(path, NetworkSettings(activation="silu" if plain else "elu"))
    assert original.facts.kind == f"rsl_rl {kind}" + ("" if plain else " with a normalizer")
    assert (original.facts.observations, original.facts.actions) == (N, A)
    assert original.memory_size == {"MLP": 0, "LSTM": 24, "GRU": 12}[kind]
    if plain:
        assert original.mean is original.deviation is None
    else:
        np.testing.assert_array_equal(original.mean, model.obs_normalizer.mean)
        np.testing.assert_allclose(original.deviation, model.obs_normalizer.std + 0.01, rtol=1e-6)
    rows = Env().get_observations()
    with torch.no_grad():
        model.reset()
        expected = torch.cat([model(row[None]) for row in rows]).numpy()
    forget = np.arange(len(rows)) == 0
    np.testing.assert_allclose(original.run(rows["policy"].numpy(), forget), expected, rtol=0, atol=1e-6)
    assert parity(original) <= 1e-5
    spoil(original, lambda values: values * np.float32(1.01))
    with pytest.raises(ContractError, match="parity"):
        parity(original)


OLD = {"2.3.3_mlp": "MLP", "3.1.2_gru": "GRU", "4.0.1_lstm": "LSTM"}


@pytest.mark.parametrize("name", OLD)
def test_older_versions_compute_the_same(name):
    path = DATA / f"rsl_rl_{name}.pt"
    original = read_rsl_rl(path, ELU)
    assert original.facts.kind == f"rsl_rl {OLD[name]} with a normalizer"
    infos = torch.load(path, weights_only=True)["infos"]
    forget = np.arange(len(infos["observations"])) == 0
    found = original.run(infos["observations"].numpy(), forget)
    np.testing.assert_allclose(found, infos["actions"], rtol=0, atol=1e-6)
    assert parity(original) <= 1e-5


def test_lost_normalizer_breaks_parity(tmp_path):
    original = read_rsl_rl(saved(tmp_path)[0], ELU)
    mean = np.array(original.mean, dtype=np.float32)
    spoil(original, lambda values: values * 0 if np.array_equal(values.ravel(), mean) else values)
    with pytest.raises(ContractError, match="weights or a normalizer differ"):
        parity(original)


@pytest.mark.parametrize("kind", KINDS)
def test_plain_module_without_rsl_rl_computes_the_same(tmp_path, monkeypatch, kind):
    path, _ = saved(tmp_path, **KINDS[kind])
    rows = Env().get_observations()["policy"].numpy()
    forget = np.arange(len(rows)) % 7 == 0
    played = read_rsl_rl(path, ELU).run(rows, forget)
    monkeypatch.setattr(Actor, "runner", lambda self, activation: None)
    np.testing.assert_allclose(read_rsl_rl(path, ELU).run(rows, forget), played, rtol=0, atol=1e-6)


def test_missing_facts_are_required(tmp_path):
    with pytest.raises(MissingSettingError, match=r"network\.activation: not in the file") as caught:
        read_rsl_rl(saved(tmp_path)[0], NetworkSettings())
    facts = caught.value.facts
    assert (facts.observations, facts.actions, facts.known) == (N, A, {"network": {"activation": "?"}})


def test_normalizer_setting_for_a_checkpoint_is_refused(tmp_path):
    with pytest.raises(
        ContractError, match=r"network\.normalizer: found 'n\.pkl', expected no setting: the checkpoint"
    ):
        read_rsl_rl(saved(tmp_path)[0], NetworkSettings(activation="elu", normalizer="n.pkl"))


# ---- what is refused ----


def refused(path):
    return refusal(read_rsl_rl, path, ELU)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """What an MLP's and an LSTM's checkpoint hold."""
    return {
        kind: torch.load(saved(tmp_path_factory.mktemp(kind), **KINDS[kind])[0], weights_only=True)
        for kind in ("MLP", "LSTM")
    }


def put(name, tensor):
    return {"actor_state_dict": {name: tensor}}


MEAN = "obs_normalizer._mean"
BAD = {
    "unknown part": (
        "MLP",
        {"estimator_state_dict": {}},
        "'estimator_state_dict': unknown, expected the keys",
    ),
    "two actors": ("MLP", {"model_state_dict": {}}, "found ['actor_state_dict', 'critic_state_dict'"),
    "no dict": ("MLP", {"actor_state_dict": 3}, "actor_state_dict: found int, expected a state_dict"),
    "unknown tensor": ("MLP", put("cnn\n", torch.zeros(2)), "'cnn\\n': unknown in an actor, expected obs_"),
    "two normalizers": (
        "MLP",
        {"obs_norm_state_dict": {"_mean": torch.zeros(1, N)}},
        f"obs_norm_state_dict: '_mean': found '{MEAN}' twice",
    ),
    "narrow normalizer": (
        "MLP",
        put(MEAN, torch.zeros(1, N - 1)),
        "obs_normalizer._mean: found torch.float32 (1, 4) contiguous, expected torch.float32 (1, 5)",
    ),
    "half a normalizer": (
        "MLP",
        put("obs_normalizer._var", None),
        "obs_normalizer: found tensors ['_mean', '_std'], exp",
    ),
    "negative": (
        "MLP",
        put("obs_normalizer._std", -torch.ones(1, N)),
        "obs_normalizer._std: found -1, expected",
    ),
    "NaN": ("MLP", put(MEAN, torch.full((1, N), torch.nan)), f"'{MEAN}': found 5 values NaN or infinite"),
    "no layer": ("MLP", put("mlp.2.weight", None), "mlp: '2.bias': found shape (7,), expected weights"),
    "no bias": ("MLP", put("mlp.2.bias", None), "mlp: found ['0.weight', '0.bias', '2.weight', '4.weight'"),
    "no spread": (
        "MLP",
        put("distribution.std_param", None),
        "distribution: found [], expected std_param or",
    ),
    "spread": (
        "MLP",
        put("distribution.std_param", torch.ones(4)),
        "distribution.std_param: found torch.float32 (4,)",
    ),
    "other gates": (
        "LSTM",
        put("rnn.rnn.weight_ih_l0", torch.zeros(6, N)),
        "rnn: found 2 layers, weight_ih_l0 (6, 5)",
    ),
    "a number": (
        "LSTM",
        put("rnn.rnn.weight_ih_l0", torch.tensor(1.0)),
        "rnn: found 2 layers, weight_ih_l0 ();",
    ),
    "no layer of memory": (
        "LSTM",
        put("rnn.rnn.weight_hh_l1", None),
        "rnn: found tensors ['bias_hh_l0', 'bias_hh_l1'",
    ),
    "other memory": (
        "LSTM",
        put("rnn.rnn.weight_hh_l1", torch.zeros(24, 7)),
        "rnn.weight_hh_l1: found torch.float32 (24, 7) contiguous, expected torch.float32 (24, 6)",
    ),
}


@pytest.mark.parametrize(("kind", "changes", "message"), BAD.values(), ids=BAD)
def test_a_bad_tensor_is_named(tmp_path, files, kind, changes, message):
    file = dict(files[kind])
    for key, change in changes.items():
        both = {**file[key], **change} if key in file and isinstance(change, dict) else change
        file[key] = {n: t for n, t in both.items() if t is not None} if isinstance(both, dict) else both
    torch.save(file, tmp_path / "x.pt")
    assert refused(tmp_path / "x.pt").startswith(message)


@pytest.mark.parametrize("distribution", ["BetaDistribution", "HeteroscedasticGaussianDistribution"])
def test_an_action_that_is_not_the_last_layer_is_refused(tmp_path, distribution):
    path, _ = saved(tmp_path, distribution=distribution)
    assert refused(path).startswith("distribution: found [")


class Evil:
    def __init__(self, witness):
        self.witness = witness

    def __reduce__(self):
        return os.mkdir, (str(self.witness),)


def test_code_is_never_run(tmp_path, files):
    witness, path = tmp_path / "witness", tmp_path / "evil.pt"
    torch.save({**files["MLP"], "infos": Evil(witness)}, path)
    assert refused(path).startswith("data.pkl: found 'posix.mkdir', expected only tensors")
    assert not witness.exists()
    torch.load(path, weights_only=False)  # the trap was armed
    assert witness.exists()
