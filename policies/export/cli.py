"""Command policy-export: write one ONNX file with its contract, if ONNX Runtime agrees with torch."""

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from rich.text import Text

from deploy.command_line import PASSED, main
from deploy.policy.compatibility import check_contract
from deploy.policy.contract import Contract
from deploy.policy.inference import BATCHES
from deploy.policy.policy import AGREEMENT, Policy
from deploy.policy.policy_file import Golden
from deploy.policy.policy_names import INPUT, OUTPUT
from deploy.telemetry.output_files import check_no_input
from deploy.telemetry.plain_console import plain_console
from eval.replay.bundle import robot_files
from policies.export.onnx_file import write_policy
from policies.export.tracing import to_onnx
from policies.training.checkpoint import Checkpoint, load_checkpoint
from robots.errors import ContractError, printable
from robots.spec import load_robot
from robots.strict import parse

POLICIES = Path(__file__).parents[1]
GOLDEN_PAIRS = 16
POLICY = typer.Option(help="Checkpoint: a name in policies/ or a path.")
OUT = typer.Option(help="ONNX file to write.", show_default="out/<policy>.onnx")
ROBOT = typer.Option(help="Robot: a name or a folder.", show_default="the contract's")


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """Result of an export.

    Attributes:
        file_bytes: size of the file.
        digest: SHA-256 of the file.
        observations: number compared at each batch size.
        deviation: largest |ONNX Runtime − torch| at each of `deploy.policy.policy.BATCHES`, raw action.
    """

    path: Path
    file_bytes: int
    digest: str
    observations: int
    deviation: tuple[float, ...]


def export(checkpoint_path: Path, out_path: Path, robot: str | Path | None = None) -> Exported:
    """Export a checkpoint; `out_path` is replaced only after all checks passed.

    Args:
        checkpoint_path: from `policy-train`. out_path: the ONNX file.
        robot: name or folder; None for the robot named in the contract.

    Raises:
        ContractError: the checkpoint is invalid, or the ONNX file computes other actions.
        RobotError: the robot is unknown or unreadable.
        OutputError: `out_path` cannot be written, or is the checkpoint or a file of the robot.
    """
    checkpoint = load_checkpoint(checkpoint_path)
    spec = load_robot(robot or checkpoint.contract.robot)
    check_contract(checkpoint.contract, spec, f"{checkpoint_path}: contract")
    check_no_input(out_path, (checkpoint_path, *(spec.folder / name for name in robot_files(spec))))
    example = torch.zeros(2, len(checkpoint.actor.mean))  # batch 1 would be taken for a constant
    batch: dict[str, object] = {"observation": {0: torch.export.Dim("batch")}}
    model = to_onnx(checkpoint.actor, (example,), [INPUT], [OUTPUT], batch)
    contract, golden = _contract(checkpoint, checkpoint_path), _golden(checkpoint, checkpoint_path)
    compare = partial(_compare, checkpoint=checkpoint, source=checkpoint_path)
    digest, deviation = write_policy(out_path, model, contract, golden, spec, compare)
    size, count = out_path.stat().st_size, len(checkpoint.rollout)
    return Exported(path=out_path, file_bytes=size, digest=digest, observations=count, deviation=deviation)


def _contract(checkpoint: Checkpoint, source: Path) -> Contract:
    """Return the contract with the normalizer's statistics of training."""
    actor = checkpoint.actor
    observed = {"mean": tuple(actor.mean.tolist()), "deviation": tuple(actor.divisor.tolist())}
    data = checkpoint.contract.model_dump() | {"observed": observed}
    return parse(data, Contract, source=f"{source}: contract", error=ContractError)


def _golden(checkpoint: Checkpoint, source: Path) -> Golden:
    rows = np.linspace(0, len(checkpoint.rollout) - 1, GOLDEN_PAIRS).round().astype(int)
    observation = checkpoint.rollout[torch.from_numpy(rows)]
    pairs = {"observation": observation.tolist(), "action": checkpoint.actor(observation).tolist()}
    return parse(pairs, Golden, source=f"{source}: golden pairs", error=ContractError)


def _compare(policy: Policy, checkpoint: Checkpoint, source: Path) -> tuple[float, ...]:
    expected = checkpoint.actor(checkpoint.rollout)
    worst = []
    for batch in BATCHES:
        found = policy.replay(checkpoint.rollout.numpy(), batch)
        deviation = np.abs(found - expected.numpy()).max(axis=1)
        if not (deviation <= AGREEMENT).all():
            row = int(deviation.argmax())
            raise ContractError(
                f"{source}: rollout row {row}: ONNX Runtime and torch differ: found {deviation[row]:.3g} "
                f"at batch {batch}, expected at most {AGREEMENT:g}"
            )
        worst.append(float(deviation.max()))
    return tuple(worst)


def find_checkpoint(policy: str) -> Path:
    """The file of that path, or of that name among the shipped policies.

    Raises:
        ContractError: neither is there.
    """
    for path in (Path(policy), POLICIES / policy):
        if os.path.isfile(path):
            return path
    known = ", ".join(sorted(path.name for path in POLICIES.glob("*.pt"))) or "none"
    raise ContractError(f"--policy {policy}: no such file, expected a path or one of policies/: {known}")


def policy_export(
    policy: Annotated[str, POLICY] = "arm.pt",
    out: Annotated[Path | None, OUT] = None,
    robot: Annotated[str | None, ROBOT] = None,
) -> int:
    """Export a checkpoint to one ONNX file with its contract, if ONNX Runtime agrees with torch."""
    checkpoint_path = find_checkpoint(policy)
    out_path = out or Path("out", f"{checkpoint_path.stem}.onnx")
    with plain_console(stderr=True).status(Text(printable(f"exporting {checkpoint_path.name}, about 10 s"))):
        exported = export(checkpoint_path, out_path, robot)
    print(_summary(exported))
    return PASSED


def _summary(exported: Exported) -> str:
    worst = ", ".join(f"{d:.1e} at batch {b}" for d, b in zip(exported.deviation, BATCHES, strict=True))
    return (
        f"{printable(str(exported.path))}: {exported.file_bytes} bytes, sha256 {exported.digest}\n"
        f"ONNX Runtime against torch on {exported.observations} observations of real rollouts: "
        f"largest deviation {worst} (at most {AGREEMENT:g})"
    )


def cli() -> None:
    """Entry point of `policy-export`."""
    main(policy_export)
