"""Network settings that a file of weights does not hold."""

from dataclasses import replace
from pathlib import Path
from typing import Literal, Self, get_args

from pydantic import Field, model_validator

from deploy.policy.contract_term import Numbers, Scales
from policies.importers.reference_policy import MissingSettingError, PolicyFacts
from robots.errors import ContractError
from robots.strict import PLACEHOLDER, Strict

Activation = Literal["elu", "relu", "tanh", "selu", "leaky_relu", "gelu", "silu", "sigmoid"]
EXPECTED = {
    "activation": f"one of {', '.join(get_args(Activation))}",
    "normalizer": "mean and std, the path of a VecNormalize file, or 'none'",
}


class NormalizerStatistics(Strict):
    """(observation - mean) / std, each (N,)."""

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
    """Table [network] of the contract's TOML; None for what is not written there."""

    activation: Activation | None = Field(
        default=None, description=f"activation between layers: {', '.join(get_args(Activation))}"
    )
    normalizer: NormalizerStatistics | str | None = Field(
        default=None,
        description='of observations: "none", { mean = [...], std = [...] }, or the path of a VecNormalize file',
    )

    def normalizer_path(self, beside: Path) -> Path | None:
        """Return the path of the normalizer's file, relative to the policy's folder; None if there is none."""
        if isinstance(self.normalizer, NormalizerStatistics):
            raise ContractError(
                f"{beside}: network.normalizer: found numbers, expected the path of a file, or 'none'"
            )
        return None if self.normalizer in (None, "none") else beside.parent / str(self.normalizer)

    def statistics(self, size: int, source: str) -> NormalizerStatistics | None:
        """Return the normalizer's statistics for `size` observations; None if there is none."""
        if self.normalizer in (None, "none"):
            return None
        expected = f'expected {{ mean = [...], std = [...] }} with {size} numbers each, or "none"'
        if not isinstance(self.normalizer, NormalizerStatistics):
            raise ContractError(f"{source}: network.normalizer: found {self.normalizer!r:.100}, {expected}")
        if (found := len(self.normalizer.mean)) != size:
            raise ContractError(f"{source}: network.normalizer: found {found} numbers, {expected}")
        return self.normalizer


def require_settings(
    facts: PolicyFacts, source: str, activation: Activation | None, normalizer: object = "none"
) -> Activation:
    """Return the activation if both settings are known.

    Raises:
        MissingSettingError: one is None; the facts have "?" in its place.
    """
    settings = {"activation": activation, "normalizer": normalizer}
    missing = [name for name, setting in settings.items() if setting is None]
    if activation is None or missing:
        message = "; ".join(f"network.{name}: not in the file, expected {EXPECTED[name]}" for name in missing)
        known = {**facts.known, "network": dict.fromkeys(missing, PLACEHOLDER)}
        raise MissingSettingError(f"{source}: {message}", replace(facts, known=known))
    return activation
