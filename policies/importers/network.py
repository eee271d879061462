"""What a file of bare weights does not say of the network that they belong to."""

from pathlib import Path
from typing import Literal

from robots.strict import Strict

Activation = Literal["elu", "relu", "tanh", "selu", "leaky_relu", "gelu", "silu", "sigmoid"]


class Network(Strict):
    """Answers, from the contract's TOML.

    Attributes:
        activation: between its layers; None: not answered.
        normalizer: file with the normalizer of its observations; "none": it had none; None: not answered.
    """

    activation: Activation | None = None
    normalizer: str | None = None

    def normalizer_path(self, beside: Path) -> Path | None:
        """Where the normalizer is, relative to the folder of the policy's file; None: it had none."""
        return None if self.normalizer in (None, "none") else beside.parent / str(self.normalizer)
