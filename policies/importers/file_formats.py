"""Which reader a file belongs to, by what is in it and not by its name."""

import zipfile
from io import BytesIO
from pathlib import Path

from policies.importers.onnx_files.foreign_onnx import load_onnx, read_onnx
from policies.importers.reference_policy import Original
from policies.importers.torch_files.network_settings import Network
from policies.importers.untrusted.zip_archive import read_bytes, read_names
from robots.errors import ContractError

ZIP = b"PK\x03\x04"
"""How an archive begins: what torch and Stable-Baselines3 save."""
EXPECTED = "expected a policy: ONNX, rsl_rl, Stable-Baselines3 or torch"


def read_original(path: Path, network: Network) -> Original:
    """Read a policy of another library; `network` answers what bare weights do not say.

    Raises:
        UnansweredError: `network` says too little.
        ContractError: it is none that is known, or its reader refuses it.
    """
    data = read_bytes(path, EXPECTED)
    if not data:
        raise ContractError(f"{path}: found an empty file, {EXPECTED}")
    if zipfile.is_zipfile(BytesIO(data)):
        return _read_archive(path, read_names(data, str(path), EXPECTED), network)
    if data.startswith(ZIP):
        raise ContractError(
            f"{path}: found the beginning of an archive without its end, expected the whole file"
        )
    return read_onnx(load_onnx(path), str(path))


def _read_archive(path: Path, names: set[str], network: Network) -> Original:
    """Torch is imported by the readers that need it: ONNX does without."""
    inner = {name.partition("/")[2] for name in names}
    if {"data", "policy.pth"} <= names:
        from policies.importers.stable_baselines.policy import read_stable_baselines

        return read_stable_baselines(path, network)
    if any(name.startswith("models/") for name in inner):
        from policies.importers.torch_files.exported_program import read_exported_program

        return read_exported_program(path)
    if any(name.startswith("code/") for name in inner):
        from policies.importers.torch_files.torchscript import read_torchscript

        return read_torchscript(path)
    return _read_tensors(path, network)


def _read_tensors(path: Path, network: Network) -> Original:
    from policies.importers.rsl_rl.checkpoint import ACTORS, read_rsl_rl
    from policies.importers.torch_files.state_dict import read_state_dict
    from policies.importers.untrusted.tensor_archive import load_tensors

    data = load_tensors(path, EXPECTED)
    keys = set(data) if isinstance(data, dict) else set()
    if {"contract", "recipe"} <= keys:
        raise ContractError(f"{path}: found a checkpoint of policy-train, expected policy-export for it")
    return (read_rsl_rl if keys & set(ACTORS) else read_state_dict)(path, network)
