"""Checkpoints of `policy-train`: tensors, numbers and text; no code."""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from pydantic import ConfigDict, Field, StrictInt
from torch import Tensor

from deploy.policy.contract import Contract
from deploy.policy.contract_term import Count
from deploy.telemetry.output_files import replacing
from policies.importers.untrusted.tensor_archive import check_tensor, check_tensors, load_tensors
from policies.training.networks import Actor
from robots.errors import ContractError
from robots.strict import Strict, parse

ROLLOUT_MIN, ROLLOUT_MAX = 1000, 4096
"""Bounds of the number of observations: `policy-export` compares the actions of all of them, one by one."""


class _File(Strict):
    """Keys of a checkpoint as stored by torch."""

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
        actor: the network for export.
        contract: of the policy.
        rollout: (K, N) float32 raw observations from real rollouts of this policy, 1000 ≤ K ≤ 4096, in time order.
        seed: of the training.
        recipe: text of the recipe.
    """

    actor: Actor
    contract: Contract
    rollout: Tensor
    seed: int
    recipe: str


def save_checkpoint(
    path: Path, actor: Actor, contract: Contract, rollout: Tensor, *, seed: int, recipe: str
) -> None:
    """Write a checkpoint atomically, if `load_checkpoint` accepts it; the arguments are its attributes."""
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
    with replacing(path) as partial:
        partial.write_bytes(bytes_of(file))


def bytes_of(file: dict[str, Any]) -> bytes:
    """Return the contents of the file that `torch.save` writes, which itself makes a RuntimeError of a full disk."""
    buffer = BytesIO()
    torch.save(file, buffer)
    return buffer.getvalue()


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint; no code in the file is run. ContractError names file, key, found and expected value."""
    return _checked(load_tensors(path, "expected a checkpoint of policy-train"), str(path))


def _checked(data: object, source: str) -> Checkpoint:
    file = parse(data, _File, source=source, error=ContractError)
    contract = Contract.from_json(file.contract, f"{source}: contract")
    actor = _actor(file, contract, source)
    rows = len(file.rollout) if file.rollout.dim() else 0
    if not ROLLOUT_MIN <= rows <= ROLLOUT_MAX:
        expected = f"expected from {ROLLOUT_MIN} to {ROLLOUT_MAX}"
        raise ContractError(f"{source}: rollout: found {rows} observations, {expected}")
    check_tensor(file.rollout, (rows, contract.observation_size), f"{source}: rollout")
    return Checkpoint(
        actor=actor, contract=contract, rollout=file.rollout, seed=file.seed, recipe=file.recipe
    )


def _actor(file: _File, contract: Contract, source: str) -> Actor:
    with torch.device("meta"):  # shapes only
        actor = Actor(contract.observation_size, contract.action_size, file.layers)
    shapes = {name: tuple(tensor.shape) for name, tensor in actor.state_dict().items()}
    check_tensors(file.actor, shapes, f"{source}: actor")
    if (least := file.actor["divisor"].min().item()) <= 0:
        raise ContractError(f"{source}: actor.divisor: found {least:g}, expected all above 0")
    actor.load_state_dict(file.actor, assign=True)
    return actor.eval().requires_grad_(False)
