"""Files of torch.save from anywhere: tensors, numbers and text; never code."""

import zipfile
from pathlib import Path

import torch
from torch import Tensor

from robots.errors import ContractError

FILE_BYTES_MAX = 256 << 20


def load_tensors(path: Path, expected: str) -> object:
    """What a file holds; nothing in it is ever run. `expected` ends messages: "expected a checkpoint of …".

    Raises:
        ContractError: it is no such archive, is too large, or holds code.
    """
    _check_archive(path, expected)
    try:
        code = torch.serialization.get_unsafe_globals_in_checkpoint(path)
        data = None if code else torch.load(path, map_location="cpu", weights_only=True)
    except Exception as e:  # bytes of unknown origin can fail in any way
        # torch's own words are kept out: they recommend loading with weights_only=False.
        raise ContractError(f"{path}: weights_only: corrupt, torch stopped at a {type(e).__name__}") from e
    if code:
        found = ", ".join(map(repr, sorted(code)))
        only = "expected only tensors, numbers and text; nothing of it was run"
        raise ContractError(f"{path}: weights_only: found {found:.300}, {only}")
    return data


def _check_archive(path: Path, expected: str) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(record.file_size for record in archive.infolist())
    except OSError as e:
        raise ContractError(f"{path}: cannot be read: {e.strerror}, {expected}") from e
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as e:
        raise ContractError(f"{path}: found no torch archive, {expected}") from e
    if size > FILE_BYTES_MAX:
        raise ContractError(f"{path}: found {size} bytes unpacked, expected at most {FILE_BYTES_MAX}")


def check_tensor(tensor: Tensor, shape: tuple[int, ...], source: str) -> None:
    """Shape before values: a tensor of a few bytes can claim any number of elements.

    Raises:
        ContractError: it is not of this shape, not float32, not laid out plainly, or not finite.
    """
    plain = tensor.layout == torch.strided and tensor.device.type == "cpu" and tensor.is_contiguous()
    if tuple(tensor.shape) != shape or tensor.dtype != torch.float32 or not plain:
        found = f"{tensor.dtype} {tuple(tensor.shape)} {'contiguous' if plain else 'not plain'}"
        raise ContractError(f"{source}: found {found}, expected torch.float32 {shape} contiguous")
    if bad := int((~tensor.isfinite()).sum()):
        raise ContractError(f"{source}: found {bad} values NaN or infinite, expected all finite")
