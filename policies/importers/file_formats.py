"""Recognition of a policy's file format by content, not by name, and dispatch to its reader."""

import zipfile
from io import BytesIO
from pathlib import Path

from policies.importers.onnx_files.foreign_onnx import load_onnx, read_onnx
from policies.importers.reference_policy import ReferencePolicy
from policies.importers.torch_files.network_settings import NetworkSettings
from policies.importers.untrusted.zip_archive import read_bytes, read_names
from robots.errors import ContractError

ZIP = b"PK\x03\x04"
"""Signature of an archive, as torch and Stable-Baselines3 save."""
EXPECTED = "expected a policy: ONNX, rsl_rl, Stable-Baselines3 or torch"


def read_policy(path: Path, network: NetworkSettings) -> ReferencePolicy:
    """Read a policy of another library.

    Args:
        path: the file.
        network: settings that a weights file does not hold.

    Raises:
        MissingSettingError: `network` lacks a setting.
        ContractError: the format is unknown, or its reader refuses the file.
    """
    data = read_bytes(path, EXPECTED)
    if not data:
        raise ContractError(f"{path}: found an empty file, {EXPECTED}")
    if zipfile.is_zipfile(BytesIO(data)):
        return _read_archive(path, read_names(data, str(path), EXPECTED), network)
    if data.startswith(ZIP):
        raise ContractError(f"{path}: found a truncated archive, expected the whole file")
    return read_onnx(load_onnx(path), str(path))


def _read_archive(path: Path, names: set[str], network: NetworkSettings) -> ReferencePolicy:
    """Import torch only in the readers that need it."""
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


def _read_tensors(path: Path, network: NetworkSettings) -> ReferencePolicy:
    from policies.importers.rsl_rl.checkpoint import ACTORS, read_rsl_rl
    from policies.importers.torch_files.state_dict import read_state_dict
    from policies.importers.untrusted.tensor_archive import load_tensors

    data = load_tensors(path, EXPECTED)
    keys = set(data) if isinstance(data, dict) else set()
    if {"contract", "recipe"} <= keys:
        raise ContractError(f"{path}: found a checkpoint of policy-train: use policy-export")
    return (read_rsl_rl if keys & set(ACTORS) else read_state_dict)(path, network)
