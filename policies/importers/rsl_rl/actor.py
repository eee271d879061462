"""An actor of rsl_rl from its weights: as a plain module for one robot, and played by its own library."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from deploy.policy.observation_terms import SIZE_MAX
from policies.importers.normalizer import Scaling
from policies.importers.reference_policy import Play
from policies.importers.torch_files.network_settings import Activation
from policies.importers.torch_files.state_dict import LAYERS_MAX, chain, mlp
from policies.importers.untrusted.tensor_archive import check_tensor
from robots.arrays import Float32s
from robots.errors import ContractError

NORMALIZER, MEMORY, MLP, SPREAD = PARTS = ("obs_normalizer.", "rnn.rnn.", "mlp.", "distribution.")
COUNT = "obs_normalizer.count"
"""Of observations in training, an integer; nothing is computed with it."""
STD_TYPES = {"std_param": "scalar", "log_std_param": "log"}
GATES: dict[int, type[nn.LSTM] | type[nn.GRU]] = {4: nn.LSTM, 3: nn.GRU}
EPS = 1e-2
"""What every version of EmpiricalNormalization adds to a deviation."""
NAMES: dict[Activation, str] = {"leaky_relu": "lrelu", "silu": "swish"}
"""Activations that rsl_rl calls by another name."""


class Remembering(nn.Module):
    """An LSTM or a GRU that keeps in buffers what one robot's steps hand on."""

    hidden: Tensor
    cell: Tensor

    def __init__(self, rnn: nn.LSTM | nn.GRU) -> None:
        super().__init__()
        self.rnn = rnn
        for name in ("hidden", "cell") if isinstance(rnn, nn.LSTM) else ("hidden",):
            self.register_buffer(name, torch.zeros(rnn.num_layers, 1, rnn.hidden_size))

    def forward(self, observation: Tensor) -> Tensor:
        """(1, N) to (1, H)."""
        if isinstance(self.rnn, nn.LSTM):
            out, (self.hidden, self.cell) = self.rnn(observation[None], (self.hidden, self.cell))
        else:
            out, self.hidden = self.rnn(observation[None], self.hidden)
        return out[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Actor:
    """What the weights of an actor say of it.

    Attributes:
        weights: as version 5 of rsl_rl names them.
        scaling: its normalizer, if it has one. rnn: its memory, if it has one.
        layers: of its MLP.
        std_type: how it keeps its spread, which decides nothing here.
    """

    weights: Mapping[str, Tensor]
    scaling: Scaling | None
    rnn: nn.LSTM | nn.GRU | None
    layers: tuple[nn.Linear, ...]
    std_type: str

    @property
    def kind(self) -> str:
        """In words."""
        return (type(self.rnn).__name__ if self.rnn else "MLP") + (
            " with a normalizer" if self.scaling else ""
        )

    @property
    def observations(self) -> int:
        """N."""
        return self.rnn.input_size if self.rnn else self.layers[0].in_features

    @property
    def actions(self) -> int:
        """A."""
        return self.layers[-1].out_features

    def module(self, activation: Activation) -> nn.Sequential:
        """(1, N) to (1, A), to be traced."""
        parts = [self.scaling, Remembering(self.rnn) if self.rnn else None, mlp(self.layers, activation)]
        return nn.Sequential(*(part for part in parts if part is not None))

    def play(self, activation: Activation) -> Play | None:
        """By rsl_rl's own classes; None: they are not installed."""
        try:
            from rsl_rl.models import MLPModel, RNNModel
        except ImportError:
            return None
        settings: dict[str, Any] = {
            "hidden_dims": [layer.out_features for layer in self.layers[:-1]],
            "activation": NAMES.get(activation, activation),
            "obs_normalization": self.scaling is not None,
            "distribution_cfg": {"class_name": "GaussianDistribution", "std_type": self.std_type},
        }
        if self.rnn:
            settings["rnn_type"] = type(self.rnn).__name__.lower()
            settings |= {"rnn_hidden_dim": self.rnn.hidden_size, "rnn_num_layers": self.rnn.num_layers}
        example = {"policy": torch.zeros(1, self.observations)}
        kind = RNNModel if self.rnn else MLPModel
        model = kind(example, {"actor": ["policy"]}, "actor", self.actions, **settings)
        count = {COUNT: torch.tensor(0)} if self.scaling else {}
        model.load_state_dict({**self.weights, **count})
        return _player(model.eval())


def _player(model: Any) -> Play:
    def play(observations: Float32s, forget: NDArray[np.bool_]) -> Float32s:
        actions = []
        with torch.no_grad():
            for row, anew in zip(torch.from_numpy(observations), forget, strict=True):
                if anew:
                    model.reset()
                actions.append(model({"policy": row[None]})[0].numpy())
        return np.array(actions, dtype=np.float32)

    return play


def read_actor(weights: Mapping[str, Tensor], source: str) -> Actor:
    """An actor from weights that are named as version 5 names them.

    Raises:
        ContractError: a tensor is missing, unknown, or of another shape.
    """
    for name in weights:
        if not name.startswith(PARTS):
            expected = ", ".join(f"{part}*" for part in PARTS)
            raise ContractError(f"{source}: {name!r:.100}: unknown in an actor, expected {expected}")
    layers = _layers(_part(weights, MLP), f"{source}: mlp")
    memory, normalizer = _part(weights, MEMORY), _part(weights, NORMALIZER)
    rnn = _rnn(memory, layers[0].in_features, f"{source}: rnn") if memory else None
    size = rnn.input_size if rnn else layers[0].in_features
    return Actor(
        weights=weights,
        scaling=_scaling(normalizer, size, f"{source}: obs_normalizer") if normalizer else None,
        rnn=rnn,
        layers=layers,
        std_type=_std_type(_part(weights, SPREAD), layers[-1].out_features, f"{source}: distribution"),
    )


def _part(weights: Mapping[str, Tensor], part: str) -> dict[str, Tensor]:
    return {name.removeprefix(part): tensor for name, tensor in weights.items() if name.startswith(part)}


def _layers(found: Mapping[str, Tensor], source: str) -> tuple[nn.Linear, ...]:
    layers = chain(found, source)
    names = {f"{2 * k}.{end}" for k in range(len(layers)) for end in ("weight", "bias")}
    if found.keys() != names or len(layers) < 2:
        raise ContractError(
            f"{source}: found {list(found)!s:.300}, expected weight and bias of layers 0, 2, 4, ..."
        )
    return tuple(layers)


def _rnn(found: Mapping[str, Tensor], size: int, source: str) -> nn.LSTM | nn.GRU:
    """From the rows of its weights; `size`: what the MLP expects of it."""
    first = found.get("weight_ih_l0")
    shape = () if first is None else tuple(first.shape)
    layers = sum(name.startswith("weight_hh_l") for name in found)
    gates = shape[0] // size if len(shape) == 2 and 1 <= shape[1] <= SIZE_MAX else 0
    if gates not in GATES or not 1 <= layers <= LAYERS_MAX:
        raise ContractError(
            f"{source}: found {layers} layers, weight_ih_l0 {shape}; expected 1 to {LAYERS_MAX} layers of"
            f" an LSTM (4·{size}, N) or a GRU (3·{size}, N), N at most {SIZE_MAX}"
        )
    rnn = GATES[gates](shape[1], size, layers, device="meta")
    _check(found, {name: tuple(tensor.shape) for name, tensor in rnn.state_dict().items()}, source)
    rnn.load_state_dict(found, assign=True)
    return rnn.requires_grad_(False)


def _scaling(found: Mapping[str, Tensor], size: int, source: str) -> Scaling:
    _check(found, dict.fromkeys(("_mean", "_var", "_std"), (1, size)), source)
    if (least := found["_std"].min().item()) < 0:
        raise ContractError(f"{source}._std: found {least:g}, expected none below 0")
    return Scaling(found["_mean"][0], found["_std"][0] + EPS)


def _std_type(found: Mapping[str, Tensor], size: int, source: str) -> str:
    """Another distribution than a Gaussian of its own spread makes its mean of twice as many outputs."""
    name = next(iter(found), "")
    if len(found) != 1 or name not in STD_TYPES:
        raise ContractError(
            f"{source}: found {list(found)!s:.300}, expected {' or '.join(STD_TYPES)} of a Gaussian"
        )
    check_tensor(found[name], (size,), f"{source}.{name}")
    return STD_TYPES[name]


def _check(found: Mapping[str, Tensor], expected: Mapping[str, tuple[int, ...]], source: str) -> None:
    if found.keys() != expected.keys():
        raise ContractError(f"{source}: found {sorted(found)!s:.300}, expected {sorted(expected)}")
    for name, shape in expected.items():
        check_tensor(found[name], shape, f"{source}.{name}")
