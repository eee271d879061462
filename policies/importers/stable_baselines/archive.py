"""Reader of zip files of Stable-Baselines3: settings and policy tensors; no code is run."""

import re
from pathlib import Path

from torch import Tensor

from policies.importers.untrusted.tensor_archive import parse_tensors
from policies.importers.untrusted.zip_archive import read_bytes, read_members
from robots.errors import ContractError
from robots.strict import read_json

SETTINGS_BYTES_MAX = 32 << 20
SETTINGS, WEIGHTS = "data", "policy.pth"
NEEDED = re.compile(r"data|policy\.pth")
EXPECTED = "expected a zip of Stable-Baselines3"


def read_zip(path: Path) -> tuple[dict[str, object], dict[str, Tensor]]:
    """Return settings, with pickled parts left as text, and weights by name. Other members are not read."""
    members = read_members(read_bytes(path, EXPECTED), NEEDED, str(path), EXPECTED)
    if missing := [name for name in (SETTINGS, WEIGHTS) if name not in members]:
        raise ContractError(f"{path}: found no {missing[0]!r} in it, {EXPECTED}")
    weights = parse_tensors(members[WEIGHTS], f"{path}: {WEIGHTS}", "expected tensors by name")
    if not isinstance(weights, dict) or not all(isinstance(item, Tensor) for item in weights.values()):
        raise ContractError(f"{path}: {WEIGHTS}: found a {type(weights).__name__}, expected tensors by name")
    text = members[SETTINGS].decode(errors="replace")
    settings = read_json(text, f"{path}: {SETTINGS}", SETTINGS_BYTES_MAX, ContractError)
    if not isinstance(settings, dict):
        found = f"found a {type(settings).__name__}"
        raise ContractError(f"{path}: {SETTINGS}: {found}, expected settings by name")
    return settings, weights
