"""What a file of bare weights does not say of the network that they belong to."""

from pathlib import Path
from typing import Literal, Self

from pydantic import model_validator

from deploy.policy.observation_terms import Numbers, Scales
from robots.errors import ContractError
from robots.strict import Strict

Activation = Literal["elu", "relu", "tanh", "selu", "leaky_relu", "gelu", "silu", "sigmoid"]


class Statistics(Strict):
    """(observation - mean) / std.

    Attributes:
        mean, std: (N,) what is taken away, and what the rest is divided by.
    """

    mean: Numbers
    std: Scales

    @model_validator(mode="after")
    def _paired(self) -> Self:
        if len(self.mean) != len(self.std):
            raise ValueError(
                f"network.normalizer: {len(self.mean)} numbers of mean but {len(self.std)} of std"
            )
        return self


class Network(Strict):
    """Answers, from the contract's TOML.

    Attributes:
        activation: between its layers; None: not answered.
        normalizer: of its observations: numbers, or a file with it; "none": it had none; None: not answered.
    """

    activation: Activation | None = None
    normalizer: Statistics | str | None = None

    def normalizer_path(self, beside: Path) -> Path | None:
        """Where the normalizer is, relative to the folder of the policy's file; None: it had none.

        Raises:
            ContractError: it was given as numbers.
        """
        if isinstance(self.normalizer, Statistics):
            raise ContractError(f"{beside}: network.normalizer: found numbers, expected a file, or none")
        return None if self.normalizer in (None, "none") else beside.parent / str(self.normalizer)

    def statistics(self, size: int, source: str) -> Statistics | None:
        """Numbers of the normalizer, one for each of so many observations; None: it had none.

        Raises:
            ContractError: it was given as a file, or with other numbers.
        """
        if self.normalizer in (None, "none"):
            return None
        expected = f'expected {{ mean = [...], std = [...] }} with {size} numbers each, or "none"'
        if not isinstance(self.normalizer, Statistics):
            raise ContractError(f"{source}: network.normalizer: found {self.normalizer!r:.100}, {expected}")
        if (found := len(self.normalizer.mean)) != size:
            raise ContractError(f"{source}: network.normalizer: found {found} numbers, {expected}")
        return self.normalizer
