"""Reader of the state_dict of an MLP: layers are found by names and shapes."""

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn

from policies.importers.reference_policy import PolicyFacts, ReferencePolicy
from policies.importers.torch_files.mlp import Normalizer, build_mlp, linear_layer
from policies.importers.torch_files.network_settings import NetworkSettings, require_settings
from policies.importers.torch_files.traced_module import trace_module
from policies.importers.untrusted.tensor_archive import check_tensor, load_tensors
from policies.importers.untrusted.zip_archive import BYTES_MAX
from robots.errors import ContractError

LAYERS_MAX = 16
WRAPPER = "state_dict"


def read_state_dict(path: Path, network: NetworkSettings) -> ReferencePolicy:
    """Read the MLP of a state_dict, or of {"state_dict": ...}, with the normalizer given in `network`.

    The actions are the output of the last linear layer; `network` must have activation and normalizer.
    """
    source = str(path)
    data = load_tensors(path, "expected the state_dict of an MLP")
    if isinstance(data, dict) and data.keys() == {WRAPPER}:
        data = data[WRAPPER]
    layers = linear_layers(check_weights(data, source), source)
    size, kind = layers[0].in_features, "state_dict of an MLP"
    statistics = network.statistics(size, source)
    facts = PolicyFacts(kind=kind, observations=size, actions=layers[-1].out_features)
    module = build_mlp(layers, require_settings(facts, source, network.activation, network.normalizer))
    if statistics is None:
        return trace_module(module, size, source, kind=kind)
    mean, std = statistics.mean, statistics.std
    module = nn.Sequential(Normalizer(torch.tensor(mean), torch.tensor(std)), module)
    return trace_module(module, size, source, kind=f"{kind} with a normalizer", mean=mean, deviation=std)


def check_weights(data: object, source: str) -> dict[str, Tensor]:
    """Return named tensors after checking that they are finite float32 of limited total size."""
    if not isinstance(data, dict) or not data:
        raise ContractError(f"{source}: found {type(data).__name__} without tensors, expected a state_dict")
    for name, tensor in data.items():
        if not isinstance(name, str) or not isinstance(tensor, Tensor):
            kind = type(tensor).__name__
            raise ContractError(f"{source}: {name!r:.100}: found {kind}, expected named tensors only")
    if (size := sum(4 * tensor.numel() for tensor in data.values())) > BYTES_MAX:  # tensors may overlap
        raise ContractError(f"{source}: found {size} bytes of weights, expected at most {BYTES_MAX}")
    for name, tensor in data.items():
        check_tensor(tensor, tuple(tensor.shape), f"{source}: {name!r:.100}")
    return dict(data)


def linear_layers(weights: Mapping[str, Tensor], source: str) -> list[nn.Linear]:
    """Return linear layers in the one order, by name or as stored, in which their widths match."""
    layers = {prefix: linear_layer(prefix, weights, source) for prefix in _prefixes(weights, source)}
    candidates = {tuple(layers), tuple(sorted(layers, key=_natural_sort_key))}
    orders = [order for order in candidates if _widths_match(order, layers)]
    if len(orders) != 1 or len(layers) > LAYERS_MAX:
        shapes = ", ".join(f"{k + 'weight'!r} {tuple(layer.weight.shape)}" for k, layer in layers.items())
        raise ContractError(
            f"{source}: found {shapes:.300}; expected 1 to {LAYERS_MAX} layers with matching widths,"
            " in exactly one order, by name or as stored"
        )
    return [layers[prefix] for prefix in orders[0]]


def _prefixes(weights: Mapping[str, Tensor], source: str) -> list[str]:
    """Return the prefixes of the linear layers' tensors, "" for a layer without name; refuse other tensors."""
    names = [name.removesuffix("weight") for name in weights if name == "weight" or name.endswith(".weight")]
    known = {name + end for name in names for end in ("weight", "bias")}
    for name, tensor in weights.items():
        if name not in known or tensor.dim() != (2 if name.endswith("weight") else 1):
            raise ContractError(
                f"{source}: {name!r:.100}: found shape {tuple(tensor.shape)}, expected weights (out, in)"
                " and biases (out,) of linear layers"
            )
    return names


def _natural_sort_key(name: str) -> str:
    """Return a sort key that puts layer 10 after layer 2."""
    return re.sub(r"\d+", lambda number: number[0].zfill(9), name)


def _widths_match(order: Sequence[str], layers: Mapping[str, nn.Linear]) -> bool:
    pairs = pairwise(layers[name] for name in order)
    return bool(order) and all(before.out_features == after.in_features for before, after in pairs)
