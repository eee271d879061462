"""Actor of rsl_rl from its weights, as a plain torch module and as a model of rsl_rl."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from deploy.policy.contract_term import SIZE_MAX
from policies.importers.reference_policy import RunSequence
from policies.importers.torch_files.mlp import Normalizer, build_mlp
from policies.importers.torch_files.network_settings import Activation
from policies.importers.torch_files.state_dict import LAYERS_MAX, linear_layers
from policies.importers.untrusted.tensor_archive import check_tensor, check_tensors
from robots.arrays import Float32s
from robots.errors import ContractError

NORMALIZER, RNN, MLP, DISTRIBUTION = PARTS = ("obs_normalizer.", "rnn.rnn.", "mlp.", "distribution.")
COUNT = "obs_normalizer.count"
"""Number of observations in training; not used."""
STD_TYPES = {"std_param": "scalar", "log_std_param": "log"}
GATES: dict[int, type[nn.LSTM] | type[nn.GRU]] = {4: nn.LSTM, 3: nn.GRU}
EPS = 1e-2
"""Added to the deviation by EmpiricalNormalization in every version."""
NAMES: dict[Activation, str] = {"leaky_relu": "lrelu", "silu": "swish"}
"""Activations with other names in rsl_rl."""


class StatefulRnn(nn.Module):
    """LSTM or GRU for one robot, with its state in buffers."""

    hidden: Tensor
    cell: Tensor

    def __init__(self, rnn: nn.LSTM | nn.GRU) -> None:
        super().__init__()
        self.rnn = rnn
        for name in ("hidden", "cell") if isinstance(rnn, nn.LSTM) else ("hidden",):
            self.register_buffer(name, torch.zeros(rnn.num_layers, 1, rnn.hidden_size))

    def forward(self, observation: Tensor) -> Tensor:
        """Return (1, H) for an observation (1, N)."""
        if isinstance(self.rnn, nn.LSTM):
            out, (self.hidden, self.cell) = self.rnn(observation[None], (self.hidden, self.cell))
        else:
            out, self.hidden = self.rnn(observation[None], self.hidden)
        return out[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Actor:
    """Parts of an actor.

    Attributes:
        weights: named as in version 5 of rsl_rl.
        normalizer: of observations, or None. rnn: recurrent layers, or None.
        layers: of the MLP.
        std_type: parametrization of the action's standard deviation; not used for the mean.
    """

    weights: Mapping[str, Tensor]
    normalizer: Normalizer | None
    rnn: nn.LSTM | nn.GRU | None
    layers: tuple[nn.Linear, ...]
    std_type: str

    @property
    def kind(self) -> str:
        """Architecture in words."""
        layers = type(self.rnn).__name__ if self.rnn else "MLP"
        return f"{layers} with a normalizer" if self.normalizer else layers

    @property
    def observations(self) -> int:
        """Observation size N."""
        return self.rnn.input_size if self.rnn else self.layers[0].in_features

    @property
    def actions(self) -> int:
        """Action size A."""
        return self.layers[-1].out_features

    def module(self, activation: Activation) -> nn.Sequential:
        """Return the module from (1, N) to (1, A), for tracing."""
        rnn = StatefulRnn(self.rnn) if self.rnn else None
        parts = (self.normalizer, rnn, build_mlp(self.layers, activation))
        return nn.Sequential(*(part for part in parts if part is not None))

    def runner(self, activation: Activation) -> RunSequence | None:
        """Return a function that runs rsl_rl's own classes; None if rsl_rl is not installed."""
        try:
            from rsl_rl.models import MLPModel, RNNModel
        except ImportError:
            return None
        settings: dict[str, Any] = {
            "hidden_dims": [layer.out_features for layer in self.layers[:-1]],
            "activation": NAMES.get(activation, activation),
            "obs_normalization": self.normalizer is not None,
            "distribution_cfg": {"class_name": "GaussianDistribution", "std_type": self.std_type},
        }
        if self.rnn:
            settings["rnn_type"] = type(self.rnn).__name__.lower()
            settings |= {"rnn_hidden_dim": self.rnn.hidden_size, "rnn_num_layers": self.rnn.num_layers}
        example = {"policy": torch.zeros(1, self.observations)}
        kind = RNNModel if self.rnn else MLPModel
        model = kind(example, {"actor": ["policy"]}, "actor", self.actions, **settings)
        count = {COUNT: torch.tensor(0)} if self.normalizer else {}
        model.load_state_dict({**self.weights, **count})
        return _runner(model.eval())


def _runner(model: Any) -> RunSequence:
    def runner(observations: Float32s, resets: NDArray[np.bool_]) -> Float32s:
        actions = []
        with torch.no_grad():
            for row, reset in zip(torch.from_numpy(observations), resets, strict=True):
                if reset:
                    model.reset()
                actions.append(model({"policy": row[None]})[0].numpy())
        return np.array(actions, dtype=np.float32)

    return runner


def read_actor(weights: Mapping[str, Tensor], source: str) -> Actor:
    """Build an actor from weights named as in version 5; refuse missing, unknown and misshapen tensors."""
    for name in weights:
        if not name.startswith(PARTS):
            expected = ", ".join(f"{part}*" for part in PARTS)
            raise ContractError(f"{source}: {name!r:.100}: unknown in an actor, expected {expected}")
    normalizer, rnn, mlp, distribution = (_part(weights, part) for part in PARTS)
    layers = _layers(mlp, f"{source}: mlp")
    recurrent = _rnn(rnn, layers[0].in_features, f"{source}: rnn") if rnn else None
    size = recurrent.input_size if recurrent else layers[0].in_features
    return Actor(
        weights=weights,
        normalizer=_normalizer(normalizer, size, f"{source}: obs_normalizer") if normalizer else None,
        rnn=recurrent,
        layers=layers,
        std_type=_std_type(distribution, layers[-1].out_features, f"{source}: distribution"),
    )


def _part(weights: Mapping[str, Tensor], part: str) -> dict[str, Tensor]:
    return {name.removeprefix(part): tensor for name, tensor in weights.items() if name.startswith(part)}


def _layers(found: Mapping[str, Tensor], source: str) -> tuple[nn.Linear, ...]:
    layers = linear_layers(found, source)
    names = {f"{2 * k}.{end}" for k in range(len(layers)) for end in ("weight", "bias")}
    if found.keys() != names or len(layers) < 2:
        raise ContractError(
            f"{source}: found {list(found)!s:.300}, expected weight and bias of layers 0, 2, 4, ..."
        )
    return tuple(layers)


def _rnn(found: Mapping[str, Tensor], size: int, source: str) -> nn.LSTM | nn.GRU:
    """Infer the RNN from the shapes of its weights; `size` is the input size of the MLP."""
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
    check_tensors(found, {name: tuple(tensor.shape) for name, tensor in rnn.state_dict().items()}, source)
    rnn.load_state_dict(found, assign=True)
    return rnn.requires_grad_(False)


def _normalizer(found: Mapping[str, Tensor], size: int, source: str) -> Normalizer:
    check_tensors(found, dict.fromkeys(("_mean", "_var", "_std"), (1, size)), source)
    if (least := found["_std"].min().item()) < 0:
        raise ContractError(f"{source}._std: found {least:g}, expected none below 0")
    return Normalizer(found["_mean"][0], found["_std"][0] + EPS)


def _std_type(found: Mapping[str, Tensor], size: int, source: str) -> str:
    """Refuse distributions other than a Gaussian with its own deviation: their mean has twice as many outputs."""
    name = next(iter(found), "")
    if len(found) != 1 or name not in STD_TYPES:
        raise ContractError(
            f"{source}: found {list(found)!s:.300}, expected {' or '.join(STD_TYPES)} of a Gaussian"
        )
    check_tensor(found[name], (size,), f"{source}.{name}")
    return STD_TYPES[name]
