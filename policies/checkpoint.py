"""Checkpoints, from `policy-train` to `policy-export`: tensors, numbers and text; never code."""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from pydantic import ConfigDict, Field, StrictInt
from torch import Tensor

from deploy.contract import Contract
from deploy.output import replacing
from deploy.terms import Count
from policies.networks import Actor
from robots.errors import ContractError
from robots.strict import Strict, parse

FILE_BYTES_MAX = 256 << 20
ROLLOUT_MIN = 1000


class _File(Strict):
    """The keys of a checkpoint as torch stores them."""

    model_config = ConfigDict(arbitrary_types_allowed=True)

    format: Literal[1]
    actor: dict[str, Tensor]
    layers: Annotated[tuple[Count, ...], Field(min_length=1, max_length=16)]
    activation: Literal["elu"]
    contract: str
    rollout: Tensor
    seed: StrictInt
    recipe: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """A trained policy.

    Attributes:
        actor: the export view.
        contract: what its numbers mean.
        rollout: (K, N) float32 raw observations from real rollouts of this policy, K ≥ 1000, in time order.
        seed: of the training.
        recipe: its settings, in the text they were given in.
    """

    actor: Actor
    contract: Contract
    rollout: Tensor
    seed: int
    recipe: str


def save_checkpoint(
    path: Path, actor: Actor, contract: Contract, rollout: Tensor, *, seed: int, recipe: str
) -> None:
    """Write a checkpoint, whole or not at all; the arguments are the attributes of `Checkpoint`.

    Raises:
        ContractError: `load_checkpoint` would refuse it.
        OutputError: the place cannot be written.
    """
    file = {
        "format": 1,
        "actor": {name: tensor.detach().cpu().clone() for name, tensor in actor.state_dict().items()},
        "layers": list(actor.layers),
        "activation": "elu",
        "contract": contract.to_json(),
        "rollout": rollout.detach().cpu().contiguous().clone(),
        "seed": seed,
        "recipe": recipe,
    }
    _checked(file, str(path))
    with replacing(path) as partial, partial.open("wb") as stream:
        torch.save(file, stream)


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint; nothing that a file holds is ever run.

    Raises:
        ContractError: naming the file, the key, what was found and what was expected.
    """
    _check_archive(path)
    return _checked(_load(path), str(path))


def _check_archive(path: Path) -> None:
    expected = "expected a checkpoint of policy-train"
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(record.file_size for record in archive.infolist())
    except OSError as e:
        raise ContractError(f"{path}: cannot be read: {e.strerror}, {expected}") from e
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as e:
        raise ContractError(f"{path}: found no torch archive, {expected}") from e
    if size > FILE_BYTES_MAX:
        raise ContractError(f"{path}: found {size} bytes unpacked, expected at most {FILE_BYTES_MAX}")


def _load(path: Path) -> object:
    try:
        code = torch.serialization.get_unsafe_globals_in_checkpoint(path)
        data = None if code else torch.load(path, map_location="cpu", weights_only=True)
    except Exception as e:  # bytes of unknown origin can fail in any way
        # torch's own words are kept out: they recommend loading with weights_only=False.
        raise ContractError(f"{path}: weights_only: corrupt, torch stopped at a {type(e).__name__}") from e
    if code:
        found = ", ".join(map(repr, sorted(code)))
        expected = "expected only tensors, numbers and text; nothing of it was run"
        raise ContractError(f"{path}: weights_only: found {found:.300}, {expected}")
    return data


def _checked(data: object, source: str) -> Checkpoint:
    file = parse(data, _File, source=source, error=ContractError)
    contract = Contract.from_json(file.contract, f"{source}: contract")
    sizes = (contract.observation_size, contract.action_size)
    with torch.device("meta"):  # shapes only
        actor = Actor(*sizes, file.layers)
    _check_weights(file.actor, actor.state_dict(), source)
    if (rows := len(file.rollout) if file.rollout.dim() else 0) < ROLLOUT_MIN:
        raise ContractError(f"{source}: rollout: found {rows} observations, expected at least {ROLLOUT_MIN}")
    _check_tensor(file.rollout, (rows, sizes[0]), f"{source}: rollout")
    actor.load_state_dict(file.actor, assign=True)
    return Checkpoint(
        actor=actor.eval().requires_grad_(False),
        contract=contract,
        rollout=file.rollout,
        seed=file.seed,
        recipe=file.recipe,
    )


def _check_weights(found: Mapping[str, Tensor], expected: Mapping[str, Any], source: str) -> None:
    if found.keys() != expected.keys():
        names = [", ".join(sorted(keys)) for keys in (found, expected)]
        raise ContractError(f"{source}: actor: found tensors {names[0]:.300}; expected {names[1]}")
    for name, tensor in found.items():
        _check_tensor(tensor, tuple(expected[name].shape), f"{source}: actor.{name}")
    if (least := found["divisor"].min().item()) <= 0:
        raise ContractError(f"{source}: actor.divisor: found {least:g}, expected all above 0")


def _check_tensor(tensor: Tensor, shape: tuple[int, ...], source: str) -> None:
    """Shape before values: a tensor of a few bytes can claim any number of elements."""
    plain = tensor.layout == torch.strided and tensor.device.type == "cpu" and tensor.is_contiguous()
    if tuple(tensor.shape) != shape or tensor.dtype != torch.float32 or not plain:
        found = f"{tensor.dtype} {tuple(tensor.shape)} {'contiguous' if plain else 'not plain'}"
        raise ContractError(f"{source}: found {found}, expected torch.float32 {shape} contiguous")
    if bad := int((~tensor.isfinite()).sum()):
        raise ContractError(f"{source}: found {bad} values NaN or infinite, expected all finite")
