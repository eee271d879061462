import os

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from torch import nn

from policies.importers.reference_policy import MissingSettingError
from policies.importers.torch_files.network_settings import NetworkSettings, NormalizerStatistics
from policies.importers.torch_files.state_dict import read_state_dict
from robots.errors import ContractError
from robots.strict import parse
from support.importers.parity import parity
from support.refusals import refusal

pytestmark = pytest.mark.slow

TANH = NetworkSettings(activation="tanh", normalizer="none")


def net(seed=0):
    torch.manual_seed(seed)
    return nn.Sequential(nn.Linear(7, 12), nn.Tanh(), nn.Linear(12, 9), nn.Tanh(), nn.Linear(9, 3))


def file_of(folder, data):
    path = folder / "net.pt"
    torch.save(data, path)
    return path


def refused(path, network=TANH, error=ContractError):
    return refusal(read_state_dict, path, network, error=error)


def test_mlp_equals_its_module(tmp_path):
    module = net()
    original = read_state_dict(file_of(tmp_path, {"state_dict": module.state_dict()}), TANH)
    assert (original.facts.observations, original.facts.actions) == (7, 3)
    assert original.batched
    assert not original.memory
    rows = np.random.default_rng(0).normal(size=(20, 7)).astype(np.float32)
    found = original.run(rows, np.ones(20, dtype=bool))
    np.testing.assert_allclose(found, module(torch.from_numpy(rows)).detach(), rtol=0, atol=1e-6)
    assert parity(original) <= 1e-5
    weight = next(t for t in original.model.graph.initializer if sorted(t.dims) == [9, 12])
    weight.raw_data = (np.frombuffer(weight.raw_data, dtype=np.float32) * 1.01).tobytes()
    with pytest.raises(ContractError, match="weights or a normalizer differ"):
        parity(original)


def named(*layers):
    """A state_dict of layers (name, outputs, inputs), as their module would keep it."""
    state = {}
    for name, outputs, inputs in layers:
        layer = nn.Linear(inputs, outputs)
        state |= {f"{name}.{key}": tensor for key, tensor in layer.state_dict().items()}
    return state


def test_layers_are_ordered_by_their_shapes(tmp_path):
    ten = [(f"net.{2 * k}", 4, 4) for k in range(6)]  # net.10 is after net.2
    for state in (named(*ten), named(("trunk.0", 8, 5), ("trunk.2", 8, 8), ("head", 2, 8))):
        message = refused(file_of(tmp_path, state), NetworkSettings(normalizer="none"), MissingSettingError)
        assert message.startswith("network.activation: not in the file, expected one of elu, relu, tanh")


def test_missing_facts_are_required(tmp_path):
    with pytest.raises(MissingSettingError) as caught:
        read_state_dict(file_of(tmp_path, net().state_dict()), NetworkSettings())
    assert caught.value.facts.known == {"network": {"activation": "?", "normalizer": "?"}}
    with pytest.raises(MissingSettingError, match=r"network\.normalizer: not in the file") as asked:
        read_state_dict(file_of(tmp_path, net().state_dict()), NetworkSettings(activation="elu"))
    assert asked.value.facts.known == {"network": {"normalizer": "?"}}
    assert (caught.value.facts.observations, caught.value.facts.actions) == (7, 3)


def test_normalizer_in_the_file_comes_first(tmp_path):
    rng, module = np.random.default_rng(1), net()
    mean, std = rng.normal(size=7) * 3, rng.uniform(0.1, 4, 7)
    said = NetworkSettings(
        activation="tanh", normalizer=NormalizerStatistics(mean=tuple(mean.tolist()), std=tuple(std.tolist()))
    )
    original = read_state_dict(file_of(tmp_path, module.state_dict()), said)
    assert original.facts.kind == "state_dict of an MLP with a normalizer"
    assert (original.mean, original.deviation) == (tuple(mean), tuple(std))
    rows = rng.normal(size=(20, 7)).astype(np.float32)
    expected = module(torch.from_numpy(((rows - mean) / std).astype(np.float32))).detach()
    np.testing.assert_allclose(original.run(rows, np.ones(20, dtype=bool)), expected, rtol=0, atol=1e-5)
    assert parity(original) <= 1e-5


def test_mismatched_normalizer_is_refused(tmp_path):
    path = file_of(tmp_path, net().state_dict())
    expected = 'expected { mean = [...], std = [...] } with 7 numbers each, or "none"'
    message = refused(path, NetworkSettings(activation="elu", normalizer="n.npz"))
    assert message == f"network.normalizer: found 'n.npz', {expected}"
    few = NormalizerStatistics(mean=(0.0,), std=(1.0,))
    assert (
        refused(path, NetworkSettings(normalizer=few)) == f"network.normalizer: found 1 numbers, {expected}"
    )
    with pytest.raises(ContractError, match=r"network\.normalizer: 2 numbers of mean but 1 of std"):
        parse({"mean": (0.0, 1.0), "std": (1.0,)}, NormalizerStatistics, source="x", error=ContractError)
    with pytest.raises(ContractError, match=r"std\.0: Input should be greater than 0"):
        parse({"mean": (0.0,), "std": (0.0,)}, NormalizerStatistics, source="x", error=ContractError)


HUGE = torch.zeros(1).expand(10**6, 10**6)
BAD = {
    "empty": ({}, "found dict without tensors, expected a state_dict"),
    "a list": ([torch.zeros(2)], "found list without tensors, expected a state_dict"),
    "text": ({"0.weight": "a"}, "'0.weight': found str, expected named tensors only"),
    "other key": (
        {**net().state_dict(), "log_std": torch.zeros(3)},
        "'log_std': found shape (3,), expected weights",
    ),
    "other\nkey": (
        {**net().state_dict(), "a\nb": torch.zeros(3)},
        "'a\\nb': found shape (3,), expected weights",
    ),
    "beside": (
        {"state_dict": net().state_dict(), "epoch": 3},
        "'state_dict': found dict, expected named",
    ),
    "norm": (
        {**named(("0", 3, 3)), "1.weight": torch.zeros(3)},
        "'1.weight': found shape (3,), expected weights",
    ),
    "broken chain": (
        named(("0", 3, 4), ("2", 2, 5)),
        "found '0.weight' (3, 4), '2.weight' (2, 5); expected 1 to",
    ),
    "two orders": (
        named(("b", 4, 4), ("a", 4, 4)),
        "found 'b.weight' (4, 4), 'a.weight' (4, 4); expected 1 to",
    ),
    "too wide": (named(("0", 1, 5000)), "'0.weight': found shape (1, 5000), expected 1 to 4096 inputs"),
    "too deep": (named(*((f"{k}", 2, 2) for k in range(17))), "found '0.weight' (2, 2), '1.weight' (2, 2)"),
    "huge": ({"0.weight": HUGE}, "found 4000000000000 bytes of weights, expected at most 268435456"),
    "bias": (
        {**named(("0", 3, 4)), "0.bias": torch.zeros(4)},
        "'0.bias': found torch.float32 (4,) contiguous",
    ),
    "double": (net().double().state_dict(), "'0.weight': found torch.float64 (12, 7) contiguous"),
    "NaN": ({"0.weight": torch.full((2, 2), torch.nan)}, "'0.weight': found 4 values NaN or infinite"),
}


@pytest.mark.parametrize(("state", "message"), BAD.values(), ids=BAD)
def test_other_networks_are_refused(tmp_path, state, message):
    assert refused(file_of(tmp_path, state)).startswith(message)


class Evil:
    def __init__(self, witness):
        self.witness = witness

    def __reduce__(self):
        return os.mkdir, (str(self.witness),)


def test_code_is_never_run(tmp_path):
    witness = tmp_path / "witness"
    path = file_of(tmp_path, {**net().state_dict(), "x": Evil(witness)})
    assert refused(path).startswith("data.pkl: found 'posix.mkdir', expected only tensors")
    assert not witness.exists()
    torch.load(path, weights_only=False)  # the trap was armed
    assert witness.exists()
