"""Which reader a file belongs to, by what is in it and not by its name."""

import zipfile
from pathlib import Path

from deploy.graph import read_model
from policies.importers.foreign_onnx import read_onnx
from policies.importers.network import Network
from policies.importers.original import Original
from robots.errors import ContractError

FILE_BYTES_MAX = 256 << 20


def read_original(path: Path, network: Network) -> Original:
    """Read a policy of another library; `network` answers what bare weights do not say.

    Raises:
        UnansweredError: `network` says too little.
        ContractError: it is none that is known, or its reader refuses it.
    """
    data = _read(path)
    if not zipfile.is_zipfile(path):
        return read_onnx(read_model(data, str(path)), str(path))
    raise ContractError(f"{path}: found an archive of no known kind")


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > FILE_BYTES_MAX:
            raise ContractError(f"{path}: {path.stat().st_size} bytes, at most {FILE_BYTES_MAX}")
        return path.read_bytes()
    except OSError as e:
        raise ContractError(f"{path}: cannot be read: {e.strerror}, expected a policy") from e
