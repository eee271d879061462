"""The zip that Stable-Baselines3 saves: the text of its settings and the tensors of its policy; never code."""

import io
import zipfile
from pathlib import Path

import torch
from torch import Tensor

from robots.errors import ContractError
from robots.strict import read_json

FILE_BYTES_MAX = 512 << 20
SETTINGS_BYTES_MAX = 32 << 20
SETTINGS, WEIGHTS = "data", "policy.pth"


def read_zip(path: Path) -> tuple[dict[str, object], dict[str, Tensor]]:
    """Settings, whose pickled parts stay text, and weights by name. No other member is read, none is written.

    Raises:
        ContractError: it is no such archive, is too large, or holds code where weights belong.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            _check_sizes(archive, str(path))
            settings, weights = (_member(archive, name, str(path)) for name in (SETTINGS, WEIGHTS))
    except OSError as e:
        raise ContractError(
            f"{path}: cannot be read: {e.strerror}, expected a zip of Stable-Baselines3"
        ) from e
    except ContractError:
        raise
    except Exception as e:  # bytes of unknown origin can fail in any way
        raise ContractError(
            f"{path}: found no zip that can be read, expected one of Stable-Baselines3"
        ) from e
    return _settings(settings, f"{path}: {SETTINGS}"), _weights(weights, f"{path}: {WEIGHTS}")


def _check_sizes(archive: zipfile.ZipFile, source: str) -> None:
    size = sum(record.file_size for record in archive.infolist())
    if size > FILE_BYTES_MAX:
        raise ContractError(f"{source}: found {size} bytes unpacked, expected at most {FILE_BYTES_MAX}")


def _member(archive: zipfile.ZipFile, name: str, source: str) -> bytes:
    if name not in archive.namelist():
        raise ContractError(f"{source}: found no {name!r} in it, expected a zip of Stable-Baselines3")
    record = archive.getinfo(name)
    # Python bounds what it unpacks at once in these two alone.
    if record.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ContractError(f"{source}: {name}: found compression {record.compress_type}, expected none")
    with archive.open(record) as stream:
        return stream.read(record.file_size + 1)


def _settings(data: bytes, source: str) -> dict[str, object]:
    settings = read_json(data.decode(errors="replace"), source, SETTINGS_BYTES_MAX, ContractError)
    if not isinstance(settings, dict):
        raise ContractError(f"{source}: found a {type(settings).__name__}, expected settings by name")
    return settings


def _weights(data: bytes, source: str) -> dict[str, Tensor]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            _check_sizes(archive, source)
        code = torch.serialization.get_unsafe_globals_in_checkpoint(io.BytesIO(data))
        weights = None if code else torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except ContractError:
        raise
    except Exception as e:  # bytes of unknown origin can fail in any way
        # torch's own words are kept out: they recommend loading with weights_only=False.
        raise ContractError(f"{source}: weights_only: corrupt, torch stopped at a {type(e).__name__}") from e
    if code:
        found = ", ".join(map(repr, sorted(code)))
        raise ContractError(f"{source}: found {found:.300}, expected only tensors; nothing of it was run")
    if not isinstance(weights, dict) or not all(isinstance(item, Tensor) for item in weights.values()):
        raise ContractError(f"{source}: found a {type(weights).__name__}, expected tensors by name")
    return weights
