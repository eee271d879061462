"""Observation normalizer as a torch module."""

from torch import Tensor, nn


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

    def forward(self, observation: Tensor) -> Tensor:
        """(1, N) to (1, N)."""
        return (observation - self.mean) / self.divisor
