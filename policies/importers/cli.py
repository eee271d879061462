"""policy-import: what people already trained, as one ONNX file with its contract, if it says what the original says."""

import hashlib
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from onnx import helper
from rich.console import Console

from deploy.command_line import PASSED, main
from deploy.policy.compatibility import task_of
from deploy.policy.contract import CONTRACT_KEY
from deploy.policy.policy import Policy
from deploy.policy.policy_file import GOLDEN_KEY, Golden
from deploy.telemetry.output_files import replacing
from policies.importers.contract_builder import Settled, settle
from policies.importers.contract_draft import read_draft
from policies.importers.file_formats import read_original
from policies.importers.onnx_files.isaac_lab import read_descriptor
from policies.importers.parity import check_parity, trials
from policies.importers.reference_policy import Facts, Original, UnansweredError
from policies.importers.standard_graph import with_our_ends
from policies.importers.template import written
from policies.importers.torch_files.network_settings import Network
from policies.importers.untrusted.resource_limits import bounded
from robots.errors import ConfigError, ContractError
from robots.models.fleet import Fleet
from robots.spec import RobotSpec, load_robot
from robots.strict import parse

GOLDEN_STEPS = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Imported:
    """What was written.

    Attributes:
        facts: what the foreign file said. digest: SHA-256 of ours. deviation: the worst, as in `check_parity`.
    """

    facts: Facts
    digest: str
    deviation: float


def import_policy(path: Path, draft_path: Path, out_path: Path, robot: str | Path | None = None) -> Imported:
    """Import a policy; `out_path` is replaced only after every check has passed.

    Args:
        path: the foreign file. draft_path: its contract's TOML. out_path: the ONNX file.
        robot: name or folder; without it the robot that the TOML names.

    Raises:
        ContractError: a file is not what it should be, or ours says something else than the original.
        RobotError: the robot is unknown or unreadable.
        OutputError: `out_path` cannot be written.
    """
    draft = read_draft(draft_path)
    spec = load_robot(robot or draft.robot)
    # What speaks against the folder is said now, not by whoever runs the policy.
    Fleet(spec, 1, collisions=True)
    original = read_original(path, draft.network)
    settled = settle(draft, original, spec, str(draft_path))
    data, played = _onnx(original, settled), trials(original, settled.columns, settled.joints)
    with replacing(out_path) as partial:
        partial.write_bytes(data)
        deviation = check_parity(_loaded(partial, spec, out_path), played, str(path))
    return Imported(facts=original.facts, digest=hashlib.sha256(data).hexdigest(), deviation=deviation)


def _onnx(original: Original, settled: Settled) -> bytes:
    model = with_our_ends(original, settled.columns.tolist(), settled.joints.tolist())
    helper.set_model_props(
        model,
        {CONTRACT_KEY: settled.contract.to_json(), GOLDEN_KEY: _golden(original, settled).model_dump_json()},
    )
    return model.SerializeToString(deterministic=True)


def _golden(original: Original, settled: Settled) -> Golden:
    """One life of the original, from its beginning."""
    theirs = original.scattered(np.random.default_rng(1), (GOLDEN_STEPS,))
    ours = original.exchanged(theirs, settled.columns)
    action = original.play(theirs, np.arange(GOLDEN_STEPS) == 0)[:, settled.joints]
    pairs = {"observation": ours.tolist(), "action": action.tolist()}
    return parse(pairs, Golden, source="golden pairs", error=ContractError)


def _loaded(partial: Path, spec: RobotSpec, out_path: Path) -> Policy:
    """The new file behind every check that it will meet on the robot."""
    try:
        return Policy.load(partial, spec)
    except ContractError as e:
        raise ContractError(str(e).replace(str(partial), f"{out_path} (not written)")) from e


def write_template(
    path: Path, draft_path: Path, descriptor: Path | None = None, robot: str | Path | None = None
) -> tuple[Facts, int]:
    """Write the contract's TOML with all that the policy's file says; returns that, and how much is still open.

    Args:
        path: the foreign file. draft_path: the TOML.
        descriptor: Isaac Lab's I/O descriptors of the task, which says what the file does not.
        robot: name or folder of the one that the policy is for, if it is known.

    Raises:
        RobotError: the robot is unknown or unreadable.
        ContractError: the policy or its descriptor cannot be read, or the TOML is there already.
        OutputError: it cannot be written.
    """
    if draft_path.exists():
        raise ContractError(f"{draft_path}: is there already, expected another place, or to remove it first")
    try:
        facts = read_original(path, Network()).facts
    except UnansweredError as e:
        facts = e.facts
    if descriptor is not None:
        facts = _described(facts, read_descriptor(descriptor, facts.observations))
    if robot is not None:
        spec = load_robot(robot)
        facts = replace(facts, known={**facts.known, "robot": spec.name, "task": task_of(spec)})
    text, still_open = written(facts, path.name)
    with replacing(draft_path) as partial:
        partial.write_text(text, encoding="utf-8")
    return facts, still_open


def _described(facts: Facts, descriptor: dict[str, Any]) -> Facts:
    """Where both speak, the policy's own file is right."""
    action = {**descriptor.get("action", {}), **facts.known.get("action", {})}
    return replace(facts, known={**descriptor, **facts.known, "action": action})


def policy_import(
    file: Annotated[Path, typer.Argument(help="the policy's file, as its library wrote it")],
    as_: Annotated[Literal["firstshift"], typer.Option("--as", help="what it becomes")] = "firstshift",
    contract: Annotated[
        Path | None, typer.Option(help="what its numbers mean", show_default="<file>.toml")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="ONNX file to write", show_default="out/<file>.onnx")
    ] = None,
    robot: Annotated[str | None, typer.Option(help="name or folder", show_default="the contract's")] = None,
    template: Annotated[
        bool, typer.Option("--template", help="write the contract as far as the file says it, and stop")
    ] = False,
    descriptor: Annotated[
        Path | None, typer.Option(help="YAML of Isaac Lab's I/O descriptors, for --template")
    ] = None,
) -> int:
    """Import a policy: ONNX, rsl_rl, Stable-Baselines3, TorchScript, torch.export, or weights with their contract."""
    draft_path = contract or file.with_suffix(".toml")
    if descriptor is not None and not template:
        raise ConfigError(f"--descriptor {descriptor}: found no --template, expected it beside")
    with bounded(file):
        if template:
            _write(file, draft_path, descriptor, robot)
        else:
            _import(file, draft_path, out or Path("out", f"{file.stem}.onnx"), robot)
    return PASSED


def _write(file: Path, draft_path: Path, descriptor: Path | None, robot: str | None) -> None:
    facts, still_open = write_template(file, draft_path, descriptor, robot)
    todo = f"{still_open} values marked ? are to be filled in" if still_open else "nothing is left to fill in"
    print(f"{draft_path}: {_said(facts)}; {todo}")


def _import(file: Path, draft_path: Path, out_path: Path, robot: str | None) -> None:
    begun = time.monotonic()
    with Console(stderr=True).status(f"importing {file.name}"):
        imported = import_policy(file, draft_path, out_path, robot)
    print(f"{out_path}: {_said(imported.facts)}, sha256 {imported.digest}")
    print(
        f"the same as the original over 1,024 observations and 16 sequences of 200, for 1 and 64 robots:"
        f" worst {imported.deviation:.1e}, in {time.monotonic() - begun:.0f} s"
    )


def _said(facts: Facts) -> str:
    return f"{facts.kind}, {facts.observations} observations, {facts.actions} actions"


def cli() -> None:
    """Entry point of `policy-import`."""
    main(policy_import)
