"""Table of the readers, one for each file format, recognised by content; a new importer adds a row to `ARCHIVES`.

A reader is a function `read_...(path, network) -> ReferencePolicy` in a module of its own. It raises ContractError
naming the file, the part, what was found and what was expected; whatever else a library raises, `read_policy` converts.
"""

import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from io import BytesIO
from pathlib import Path
from pkgutil import resolve_name

from deploy.policy.onnx_graph import shortened
from deploy.start import RESOURCES
from policies.importers.onnx_files.foreign_onnx import load_onnx, read_onnx
from policies.importers.reference_policy import ReferencePolicy
from policies.importers.torch_files.network_settings import NetworkSettings
from policies.importers.untrusted.zip_archive import read_bytes, read_names
from robots.errors import ContractError, FirstshiftError

ZIP = b"PK\x03\x04"
"""Signature of an archive, as torch and Stable-Baselines3 save."""
EXPECTED = "expected a policy: ONNX, rsl_rl, Stable-Baselines3 or torch"


class Archive:
    """Contents of a zip archive that tell its format.

    Attributes:
        names: of all members. folders: first folder of each inside torch's outer folder.
    """

    def __init__(self, path: Path, data: bytes) -> None:
        self._path, self.names = path, read_names(data, str(path), EXPECTED)
        self.folders = {name.split("/")[1] for name in self.names if name.count("/") > 1}

    @cached_property
    def keys(self) -> set[str]:
        """Keys of the dictionary in a file of torch.save; empty for other contents."""
        from policies.importers.untrusted.tensor_archive import load_tensors

        data = load_tensors(self._path, EXPECTED)
        return set(data) if isinstance(data, dict) else set()


ARCHIVES: tuple[tuple[Callable[[Archive], bool], str], ...] = (
    (lambda a: {"data", "policy.pth"} <= a.names, "stable_baselines.policy:read_stable_baselines"),
    (lambda a: "models" in a.folders, "torch_files.exported_program:read_exported_program"),
    (lambda a: "code" in a.folders, "torch_files.torchscript:read_torchscript"),
    (lambda a: {"contract", "recipe"} <= a.keys, "readers:refuse_own_checkpoint"),
    (
        lambda a: bool(a.keys & {"actor_state_dict", "model_state_dict"}),
        "rsl_rl.actor_checkpoint:read_rsl_rl",
    ),
    (lambda _: True, "torch_files.state_dict:read_state_dict"),
)
"""Archive formats and their readers; the first that matches is imported, since torch takes seconds to import."""


def read_policy(path: Path, network: NetworkSettings) -> ReferencePolicy:
    """Read a policy of another library.

    Raises:
        ContractError: the file cannot be read, whatever a library raised for it.
        MissingSettingError: `network` lacks a setting that the file has not.
        ImportError, MemoryError, OSError: the computer lacks a library, memory, or another resource.
    """
    try:
        return _read(path, network)
    except (FirstshiftError, ImportError, MemoryError):
        raise
    except Exception as e:  # a file of unknown origin can make libraries fail in any way
        if isinstance(e, OSError) and e.errno in RESOURCES:
            raise
        found = ": ".join(filter(None, (type(e).__name__, shortened(e))))
        raise ContractError(f"{path}: cannot be read: {found}") from e


def _read(path: Path, network: NetworkSettings) -> ReferencePolicy:
    data = read_bytes(path, EXPECTED)
    if not data:
        raise ContractError(f"{path}: found an empty file, {EXPECTED}")
    if not zipfile.is_zipfile(BytesIO(data)):
        if data.startswith(ZIP):
            raise ContractError(f"{path}: found a truncated archive, expected the whole file")
        model, files = load_onnx(path)
        return replace(read_onnx(model, str(path)), files=files)
    archive = Archive(path, data)
    reader = next(reader for matches, reader in ARCHIVES if matches(archive))
    policy: ReferencePolicy = resolve_name(f"policies.importers.{reader}")(path, network)
    return policy


def refuse_own_checkpoint(path: Path, _network: NetworkSettings) -> ReferencePolicy:
    """Refuse a checkpoint of policy-train, which has its contract already."""
    raise ContractError(f"{path}: found a checkpoint of policy-train: use policy-export")
