"""Which reader a file belongs to, by what is in it and not by its name."""

import zipfile
from pathlib import Path

from deploy.policy_file import FILE_BYTES_MAX
from policies.importers.foreign_onnx import load_onnx, read_onnx
from policies.importers.network import Network
from policies.importers.original import Original
from robots.errors import ContractError


def read_original(path: Path, network: Network) -> Original:
    """Read a policy of another library; `network` answers what bare weights do not say.

    Raises:
        UnansweredError: `network` says too little.
        ContractError: it is none that is known, or its reader refuses it.
    """
    _check(path)
    if not zipfile.is_zipfile(path):
        return read_onnx(load_onnx(path), str(path))
    return _read_archive(path, _names(path), network)


def _read_archive(path: Path, names: set[str], network: Network) -> Original:
    """Torch is imported by the readers that need it: ONNX does without."""
    inner = {name.partition("/")[2] for name in names}
    if {"data", "policy.pth"} <= names:
        from policies.importers.stable_baselines import read_stable_baselines

        return read_stable_baselines(path, network)
    if any(name.startswith("models/") for name in inner):
        from policies.importers.exported_program import read_exported_program

        return read_exported_program(path)
    if any(name.startswith("code/") for name in inner):
        from policies.importers.torchscript import read_torchscript

        return read_torchscript(path)
    return _read_tensors(path, network)


def _read_tensors(path: Path, network: Network) -> Original:
    from policies.archive import load_tensors
    from policies.importers.rsl_rl import ACTORS, read_rsl_rl
    from policies.importers.state_dict import read_state_dict

    data = load_tensors(path, "expected a policy of rsl_rl, Stable-Baselines3 or torch")
    keys = set(data) if isinstance(data, dict) else set()
    if {"contract", "recipe"} <= keys:
        raise ContractError(f"{path}: found a checkpoint of policy-train, expected policy-export for it")
    return (read_rsl_rl if keys & set(ACTORS) else read_state_dict)(path, network)


def _names(path: Path) -> set[str]:
    try:
        with zipfile.ZipFile(path) as archive:
            return set(archive.namelist())
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as e:
        raise ContractError(f"{path}: found an archive that cannot be read: a {type(e).__name__}") from e


def _check(path: Path) -> None:
    try:
        if path.stat().st_size > FILE_BYTES_MAX:
            raise ContractError(f"{path}: {path.stat().st_size} bytes, at most {FILE_BYTES_MAX}")
        with path.open("rb"):
            pass
    except OSError as e:
        raise ContractError(f"{path}: cannot be read: {e.strerror}, expected a policy") from e
