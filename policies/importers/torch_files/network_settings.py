"""Network settings that a file of weights does not hold."""

from pathlib import Path
from typing import Literal, Self

from pydantic import model_validator

from deploy.policy.contract_term import Numbers, Scales
from robots.errors import ContractError
from robots.strict import Strict

Activation = Literal["elu", "relu", "tanh", "selu", "leaky_relu", "gelu", "silu", "sigmoid"]


class NormalizerStatistics(Strict):
    """(observation - mean) / std.

    Attributes:
        mean, std: (N,) subtracted, and divided by.
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


class NetworkSettings(Strict):
    """Table [network] of the contract's TOML.

    Attributes:
        activation: between layers; None if not given.
        normalizer: of observations: statistics, or the path of a file; "none" if there is none; None if not given.
    """

    activation: Activation | None = None
    normalizer: NormalizerStatistics | str | None = None

    def normalizer_path(self, beside: Path) -> Path | None:
        """Return the path of the normalizer's file, relative to the policy's folder; None if there is none.

        Raises:
            ContractError: the normalizer is given as numbers.
        """
        if isinstance(self.normalizer, NormalizerStatistics):
            raise ContractError(
                f"{beside}: network.normalizer: found numbers, expected the path of a file, or 'none'"
            )
        return None if self.normalizer in (None, "none") else beside.parent / str(self.normalizer)

    def statistics(self, size: int, source: str) -> NormalizerStatistics | None:
        """Return the normalizer's statistics for `size` observations; None if there is none.

        Raises:
            ContractError: the normalizer is given as a file, or has another size.
        """
        if self.normalizer in (None, "none"):
            return None
        expected = f'expected {{ mean = [...], std = [...] }} with {size} numbers each, or "none"'
        if not isinstance(self.normalizer, NormalizerStatistics):
            raise ContractError(f"{source}: network.normalizer: found {self.normalizer!r:.100}, {expected}")
        if (found := len(self.normalizer.mean)) != size:
            raise ContractError(f"{source}: network.normalizer: found {found} numbers, {expected}")
        return self.normalizer
