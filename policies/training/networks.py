"""Actor network for export: from a raw observation to a raw action."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Self

import torch
from torch import Tensor, nn

from robots.errors import ContractError

if TYPE_CHECKING:
    from rsl_rl.models import MLPModel


class Actor(nn.Module):
    """action = MLP((observation - mean) / divisor), ELU between the layers, no last activation.

    Attributes:
        mean: (N,) of the observations in training.
        divisor: (N,) standard deviation plus the learner's epsilon, stored as one number to round once.
    """

    mean: Tensor
    divisor: Tensor

    def __init__(self, observation_size: int, action_size: int, layers: Sequence[int]) -> None:
        super().__init__()
        self.layers = tuple(layers)
        self.register_buffer("mean", torch.zeros(observation_size))
        self.register_buffer("divisor", torch.ones(observation_size))
        widths = pairwise((observation_size, *layers, action_size))
        parts = [part for width in widths for part in (nn.Linear(*width), nn.ELU())]
        self.mlp = nn.Sequential(*parts[:-1])

    def forward(self, observation: Tensor) -> Tensor:
        """Return raw actions (B, A) for raw observations (B, N)."""
        return self.mlp((observation - self.mean) / self.divisor)

    @classmethod
    def from_rsl_rl(cls, model: "MLPModel") -> Self:
        """Copy a trained actor of rsl_rl: its normalizer, its MLP, the mean of its distribution.

        Raises:
            ContractError: the model has a part that this network does not have.
        """
        for complaint in _unsupported_parts(model):
            raise ContractError(f"rsl_rl actor: {complaint}")
        linear = [layer for layer in model.mlp if isinstance(layer, nn.Linear)]
        actor = cls(model.obs_dim, linear[-1].out_features, [layer.out_features for layer in linear[:-1]])
        actor.mlp.load_state_dict(model.mlp.state_dict())
        if model.obs_normalization:
            actor.mean.copy_(model.obs_normalizer.mean)
            actor.divisor.copy_(model.obs_normalizer.std + model.obs_normalizer.eps)
        return actor.eval().requires_grad_(False)


def _unsupported_parts(model: "MLPModel") -> Iterator[str]:
    # Imported here: an export from a checkpoint needs no learner.
    from rsl_rl.models import MLPModel
    from rsl_rl.modules import EmpiricalNormalization
    from rsl_rl.modules.distribution import GaussianDistribution

    # Exact types: a subclass may compute something else under the same attributes.
    for part, found, expected in (
        ("", model, MLPModel),
        ("normalizer ", model.obs_normalizer if model.obs_normalization else None, EmpiricalNormalization),
        ("distribution ", model.distribution, GaussianDistribution),
    ):
        if found is not None and type(found) is not expected:
            yield f"found {part}{type(found).__name__}, expected {expected.__name__}"
    layers = [type(layer).__name__ for layer in model.mlp]
    if layers != (plain := ["Linear", "ELU"] * (len(layers) // 2) + ["Linear"]):
        yield f"found layers {', '.join(layers)}, expected {', '.join(plain)}"
