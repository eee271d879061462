"""Bare weights of an MLP, as torch.save keeps a state_dict: its layers follow from names and shapes."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn

from deploy.policy.observation_terms import SIZE_MAX
from policies.importers.normalizer import Scaling
from policies.importers.reference_policy import Facts, Original, UnansweredError
from policies.importers.torch_files.activations import ACTIVATIONS
from policies.importers.torch_files.network_settings import Activation, Network
from policies.importers.torch_files.traced_module import read_module
from policies.importers.untrusted.tensor_archive import check_tensor, load_tensors
from policies.importers.untrusted.zip_archive import BYTES_MAX
from robots.errors import ContractError

LAYERS_MAX = 16
WRAPPER = "state_dict"


def read_state_dict(path: Path, network: Network) -> Original:
    """The MLP of a state_dict, or of {"state_dict": ...}, behind the normalizer that `network` holds.

    Nothing squashes its actions.

    Raises:
        UnansweredError: its activation is not answered, or whether a normalizer went with it.
        ContractError: the file holds code, or anything but the weights of one MLP.
    """
    data = load_tensors(path, "expected the state_dict of an MLP")
    if isinstance(data, dict) and data.keys() == {WRAPPER}:
        data = data[WRAPPER]
    weights = weights_of(data, str(path))
    layers = chain(weights, str(path))
    facts = Facts(
        kind="state_dict of an MLP", observations=layers[0].in_features, actions=layers[-1].out_features
    )
    statistics = network.statistics(facts.observations, str(path))
    if network.normalizer is None:
        asked = {} if network.activation else {"activation": "?"}
        message = f"{path}: network.normalizer: not in the file, expected an answer: numbers, or none"
        raise UnansweredError(message, replace(facts, known={"network": {**asked, "normalizer": "?"}}))
    module = mlp(layers, answered(network, facts, str(path)))
    if statistics is None:
        return read_module(module, facts.observations, str(path), kind=facts.kind)
    mean, std = statistics.mean, statistics.std
    whole = nn.Sequential(Scaling(torch.tensor(mean), torch.tensor(std)), module)
    original = read_module(whole, facts.observations, str(path), kind=f"{facts.kind} with a normalizer")
    return replace(original, mean=mean, deviation=std)


def weights_of(data: object, source: str) -> dict[str, Tensor]:
    """Named tensors that can be weights: finite float32, and no more of them than a file may hold.

    Raises:
        ContractError: something else is among them.
    """
    if not isinstance(data, dict) or not data:
        raise ContractError(f"{source}: found {type(data).__name__} of no tensors, expected a state_dict")
    for name, tensor in data.items():
        if not isinstance(name, str) or not isinstance(tensor, Tensor):
            kind = type(tensor).__name__
            raise ContractError(f"{source}: {name!r:.100}: found {kind}, expected only named tensors")
    if (size := sum(4 * tensor.numel() for tensor in data.values())) > BYTES_MAX:  # tensors may overlap
        raise ContractError(f"{source}: found {size} bytes of weights, expected at most {BYTES_MAX}")
    for name, tensor in data.items():
        check_tensor(tensor, tuple(tensor.shape), f"{source}: {name!r:.100}")
    return dict(data)


def chain(weights: Mapping[str, Tensor], source: str) -> list[nn.Linear]:
    """Linear layers, each as wide as the one before it, by their names or as they stand in the file.

    Raises:
        ContractError: another tensor is among them, or no order or more than one is possible.
    """
    names = [name.removesuffix("weight") for name in weights if name == "weight" or name.endswith(".weight")]
    known = {name + end for name in names for end in ("weight", "bias")}
    for name, tensor in weights.items():
        if name not in known or tensor.dim() != (2 if name.endswith("weight") else 1):
            raise ContractError(
                f"{source}: {name!r:.100}: found shape {tuple(tensor.shape)}, expected only weights (out, in)"
                " and biases (out,) of linear layers"
            )
    layers = {name: _linear(name, weights, source) for name in names}
    possible = [order for order in {tuple(names), tuple(sorted(names, key=_natural))} if _fits(order, layers)]
    if len(possible) != 1 or len(names) > LAYERS_MAX:
        shapes = ", ".join(f"{name + 'weight'!r} {tuple(layers[name].weight.shape)}" for name in names)
        raise ContractError(
            f"{source}: found {shapes:.300}; expected 1 to {LAYERS_MAX} layers, each of the width that the one"
            " before it gives, in one order, by their names or as they stand"
        )
    return [layers[name] for name in possible[0]]


def answered(network: Network, facts: Facts, source: str) -> Activation:
    """The activation between the layers of a file that has no words for it.

    Raises:
        UnansweredError: nobody answered.
    """
    if network.activation is None:
        expected = ", ".join(ACTIVATIONS)
        message = f"{source}: network.activation: not in the file, expected an answer: {expected}"
        raise UnansweredError(message, replace(facts, known={"network": {"activation": "?"}}))
    return network.activation


def mlp(layers: Sequence[nn.Linear], activation: Activation) -> nn.Sequential:
    """An activation between layers, none after the last."""
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


def _natural(name: str) -> str:
    """So that layer 10 comes after layer 2."""
    return re.sub(r"\d+", lambda number: number[0].zfill(9), name)


def _fits(order: Sequence[str], layers: Mapping[str, nn.Linear]) -> bool:
    joints = pairwise(layers[name] for name in order)
    return bool(order) and all(before.out_features == after.in_features for before, after in joints)
