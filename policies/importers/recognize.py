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
    raise ContractError(f"{path}: found an archive of no known kind")


def _check(path: Path) -> None:
    try:
        if path.stat().st_size > FILE_BYTES_MAX:
            raise ContractError(f"{path}: {path.stat().st_size} bytes, at most {FILE_BYTES_MAX}")
        with path.open("rb"):
            pass
    except OSError as e:
        raise ContractError(f"{path}: cannot be read: {e.strerror}, expected a policy") from e
