"""Reader of the state_dict of an MLP: layers are found by names and shapes."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn

from deploy.policy.contract_term import SIZE_MAX
from policies.importers.normalizer import Normalizer
from policies.importers.reference_policy import MissingSettingError, PolicyFacts, ReferencePolicy
from policies.importers.torch_files.activations import ACTIVATIONS
from policies.importers.torch_files.network_settings import Activation, NetworkSettings
from policies.importers.torch_files.traced_module import trace_module
from policies.importers.untrusted.tensor_archive import check_tensor, load_tensors
from policies.importers.untrusted.zip_archive import BYTES_MAX
from robots.errors import ContractError

LAYERS_MAX = 16
WRAPPER = "state_dict"


def read_state_dict(path: Path, network: NetworkSettings) -> ReferencePolicy:
    """Read the MLP of a state_dict, or of {"state_dict": ...}, with the normalizer given in `network`.

    The actions are the output of the last linear layer.

    Raises:
        MissingSettingError: `network` lacks the activation or the normalizer.
        ContractError: the file holds code, or anything but the weights of one MLP.
    """
    data = load_tensors(path, "expected the state_dict of an MLP")
    if isinstance(data, dict) and data.keys() == {WRAPPER}:
        data = data[WRAPPER]
    weights = check_weights(data, str(path))
    layers = linear_layers(weights, str(path))
    facts = PolicyFacts(
        kind="state_dict of an MLP", observations=layers[0].in_features, actions=layers[-1].out_features
    )
    statistics = network.statistics(facts.observations, str(path))
    if network.normalizer is None:
        missing = {} if network.activation else {"activation": "?"}
        message = f"{path}: network.normalizer: not in the file, expected mean and std, or 'none'"
        raise MissingSettingError(message, replace(facts, known={"network": {**missing, "normalizer": "?"}}))
    module = build_mlp(layers, required_activation(network, facts, str(path)))
    if statistics is None:
        return trace_module(module, facts.observations, str(path), kind=facts.kind)
    mean, std = statistics.mean, statistics.std
    normalized = nn.Sequential(Normalizer(torch.tensor(mean), torch.tensor(std)), module)
    reference = trace_module(
        normalized, facts.observations, str(path), kind=f"{facts.kind} with a normalizer"
    )
    return replace(reference, mean=mean, deviation=std)


def check_weights(data: object, source: str) -> dict[str, Tensor]:
    """Return named tensors after checking that they are finite float32 of limited total size.

    Raises:
        ContractError: naming what else was found.
    """
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
    """Return linear layers in the one order, by name or as stored, in which their widths match.

    Raises:
        ContractError: there is another tensor, or no order or more than one matches.
    """
    names = [name.removesuffix("weight") for name in weights if name == "weight" or name.endswith(".weight")]
    known = {name + end for name in names for end in ("weight", "bias")}
    for name, tensor in weights.items():
        if name not in known or tensor.dim() != (2 if name.endswith("weight") else 1):
            raise ContractError(
                f"{source}: {name!r:.100}: found shape {tuple(tensor.shape)}, expected weights (out, in)"
                " and biases (out,) of linear layers"
            )
    layers = {name: _linear(name, weights, source) for name in names}
    candidates = {tuple(names), tuple(sorted(names, key=_natural_sort_key))}
    orders = [order for order in candidates if _widths_match(order, layers)]
    if len(orders) != 1 or len(names) > LAYERS_MAX:
        shapes = ", ".join(f"{name + 'weight'!r} {tuple(layers[name].weight.shape)}" for name in names)
        raise ContractError(
            f"{source}: found {shapes:.300}; expected 1 to {LAYERS_MAX} layers with matching widths,"
            " in exactly one order, by name or as stored"
        )
    return [layers[name] for name in orders[0]]


def required_activation(network: NetworkSettings, facts: PolicyFacts, source: str) -> Activation:
    """Return the activation given in `network`.

    Raises:
        MissingSettingError: it is not given.
    """
    if network.activation is None:
        expected = ", ".join(ACTIVATIONS)
        message = f"{source}: network.activation: not in the file, expected one of {expected}"
        raise MissingSettingError(message, replace(facts, known={"network": {"activation": "?"}}))
    return network.activation


def build_mlp(layers: Sequence[nn.Linear], activation: Activation) -> nn.Sequential:
    """Return an MLP with the activation between layers, none after the last."""
    parts = [part for layer in layers for part in (layer, ACTIVATIONS[activation]())]
    return nn.Sequential(*parts[:-1])


def _linear(name: str, weights: Mapping[str, Tensor], source: str) -> nn.Linear:
    weight, bias = weights[f"{name}weight"], weights.get(f"{name}bias")
    shape = tuple(weight.shape)
    if not all(1 <= size <= SIZE_MAX for size in shape):
        found = f"{name + 'weight'!r:.100}: found shape {shape}"
        raise ContractError(f"{source}: {found}, expected 1 to {SIZE_MAX} inputs and outputs")
    layer = nn.Linear(shape[1], shape[0], bias=bias is not None, device="meta")
    layer.weight = nn.Parameter(weight, requires_grad=False)
    if bias is not None:
        check_tensor(bias, shape[:1], f"{source}: {name + 'bias'!r:.100}")
        layer.bias = nn.Parameter(bias, requires_grad=False)
    return layer


def _natural_sort_key(name: str) -> str:
    """Return a sort key that puts layer 10 after layer 2."""
    return re.sub(r"\d+", lambda number: number[0].zfill(9), name)


def _widths_match(order: Sequence[str], layers: Mapping[str, nn.Linear]) -> bool:
    pairs = pairwise(layers[name] for name in order)
    return bool(order) and all(before.out_features == after.in_features for before, after in pairs)
