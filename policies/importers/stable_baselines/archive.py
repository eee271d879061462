"""The zip that Stable-Baselines3 saves: the text of its settings and the tensors of its policy; never code."""

import re
from pathlib import Path

from torch import Tensor

from policies.importers.untrusted.tensor_archive import tensors_of
from policies.importers.untrusted.zip_archive import read_bytes, read_members
from robots.errors import ContractError
from robots.strict import read_json

SETTINGS_BYTES_MAX = 32 << 20
SETTINGS, WEIGHTS = "data", "policy.pth"
NEEDED = re.compile(r"data|policy\.pth")
EXPECTED = "expected a zip of Stable-Baselines3"


def read_zip(path: Path) -> tuple[dict[str, object], dict[str, Tensor]]:
    """Settings, whose pickled parts stay text, and weights by name. No other member is read, none is written.

    Raises:
        ContractError: it is no such archive, is too large, or holds code where weights belong.
    """
    members = read_members(read_bytes(path, EXPECTED), NEEDED, str(path), EXPECTED)
    if missing := [name for name in (SETTINGS, WEIGHTS) if name not in members]:
        raise ContractError(f"{path}: found no {missing[0]!r} in it, {EXPECTED}")
    weights = tensors_of(members[WEIGHTS], f"{path}: {WEIGHTS}", "expected tensors by name")
    if not isinstance(weights, dict) or not all(isinstance(item, Tensor) for item in weights.values()):
        raise ContractError(f"{path}: {WEIGHTS}: found a {type(weights).__name__}, expected tensors by name")
    return _settings(members[SETTINGS], f"{path}: {SETTINGS}"), weights


def _settings(data: bytes, source: str) -> dict[str, object]:
    settings = read_json(data.decode(errors="replace"), source, SETTINGS_BYTES_MAX, ContractError)
    if not isinstance(settings, dict):
        raise ContractError(f"{source}: found a {type(settings).__name__}, expected settings by name")
    return settings
