"""Multilayer perceptrons and normalizers from checked tensors."""

from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor, nn

from deploy.policy.contract_term import SIZE_MAX
from policies.importers.torch_files.network_settings import Activation
from policies.importers.untrusted.tensor_archive import check_tensor
from robots.errors import ContractError

ACTIVATIONS: dict[Activation, type[nn.Module]] = {
    "elu": nn.ELU,
    "relu": nn.ReLU,
    "tanh": nn.Tanh,
    "selu": nn.SELU,
    "leaky_relu": nn.LeakyReLU,
    "gelu": nn.GELU,
    "silu": nn.SiLU,
    "sigmoid": nn.Sigmoid,
}


class Normalizer(nn.Module):
    """(observation - mean) / divisor.

    Attributes:
        mean, divisor: (N,) mean and standard deviation of the observations in training.
    """

    mean: Tensor
    divisor: Tensor

    def __init__(self, mean: Tensor, divisor: Tensor) -> None:
        super().__init__()
        self.register_buffer("mean", mean)
        self.register_buffer("divisor", divisor)

    @property
    def statistics(self) -> dict[str, Any]:
        """Mean and deviation, as in `ReferencePolicy`."""
        return {"mean": tuple(self.mean.tolist()), "deviation": tuple(self.divisor.tolist())}

    def forward(self, observation: Tensor) -> Tensor:
        """(1, N) to (1, N)."""
        return (observation - self.mean) / self.divisor


def linear_layer(prefix: str, weights: Mapping[str, Tensor], source: str) -> nn.Linear:
    """Return the layer of the tensors `prefix`weight (out, in) and, if there is one, `prefix`bias (out,).

    Shapes are checked before values: a tensor of a few bytes can claim any number of elements.
    """
    weight, bias = weights[f"{prefix}weight"], weights.get(f"{prefix}bias")
    shape, where = tuple(weight.shape), f"{source}: {prefix + 'weight'!r:.100}"
    if len(shape) != 2 or not all(1 <= size <= SIZE_MAX for size in shape):
        raise ContractError(f"{where}: found shape {shape}, expected 1 to {SIZE_MAX} inputs and outputs")
    check_tensor(weight, shape, where)
    layer = nn.Linear(shape[1], shape[0], bias=bias is not None, device="meta")
    layer.weight = nn.Parameter(weight, requires_grad=False)
    if bias is not None:
        check_tensor(bias, shape[:1], f"{source}: {prefix + 'bias'!r:.100}")
        layer.bias = nn.Parameter(bias, requires_grad=False)
    return layer


def build_mlp(layers: Sequence[nn.Linear], activation: Activation, *last: nn.Module) -> nn.Sequential:
    """Return an MLP with the activation between layers, and `last` after the last layer."""
    parts = [part for layer in layers for part in (layer, ACTIVATIONS[activation]())]
    return nn.Sequential(*parts[:-1], *last)
