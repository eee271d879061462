"""Command policy-import: convert a policy of another library to one ONNX file with its contract."""

import os
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from rich.text import Text

from deploy.command_line import PASSED, main
from deploy.policy.policy_file import Golden
from deploy.tasks.task import tasks_of
from deploy.telemetry.output_files import check_file, check_no_input, replacing
from deploy.telemetry.plain_console import plain_console
from eval.replay.bundle import robot_files
from policies.export.onnx_file import write_policy
from policies.importers.contract_builder import BuiltContract, build_contract
from policies.importers.contract_draft import read_draft
from policies.importers.contract_template import render_template
from policies.importers.onnx_files.isaac_lab import read_descriptor
from policies.importers.parity import check_parity, record_reference
from policies.importers.readers import read_policy
from policies.importers.reference_policy import MissingSettingError, PolicyFacts, ReferencePolicy
from policies.importers.standard_graph import to_standard_graph
from policies.importers.torch_files.network_settings import NetworkSettings
from policies.importers.untrusted.resource_limits import limit_memory
from robots.errors import ConfigError, ContractError, printable
from robots.files import is_missing
from robots.models.fleet import Fleet
from robots.spec import RobotSpec, load_robot
from robots.strict import parse

GOLDEN_STEPS = 16
FORMAT = typer.Option("--as", help="output format")
CONTRACT = typer.Option(help="TOML of its contract", show_default="<file>.toml")
OUT = typer.Option(help="ONNX file to write", show_default="out/<file>.onnx")
ROBOT = typer.Option(help="robot: name or folder", show_default="the contract's")
TEMPLATE = typer.Option(
    "--template", help="write the contract's TOML with the values known from the file, and stop"
)
DESCRIPTOR = typer.Option(help="YAML of Isaac Lab's I/O descriptors; only with --template")


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportResult:
    """Result of an import.

    Attributes:
        facts: description of the imported file. digest: SHA-256 of the written file.
        deviation: largest deviation from the reference, as in `check_parity`.
    """

    facts: PolicyFacts
    digest: str
    deviation: float


def import_policy(
    path: Path, draft_path: Path, out_path: Path, robot: str | Path | None = None
) -> ImportResult:
    """Import a policy; `out_path` is replaced only after all checks passed.

    Args:
        path: the policy's file. draft_path: its contract's TOML. out_path: the ONNX file to write.
        robot: name or folder; None for the robot named in the TOML.

    Raises:
        ContractError: a file is invalid, or the ONNX file computes other actions than the reference.
        RobotError: the robot is unknown or unreadable.
        OutputError: `out_path` cannot be written, or is a file that is read: an argument, one that it names, or one of
            the robot.
    """
    draft = read_draft(draft_path)
    spec = load_robot(robot or draft.robot)
    # Errors in the robot's folder are reported now, not when the policy is run.
    Fleet(spec, 1, collisions=True)
    reference = read_policy(path, draft.network)
    robot_paths = (spec.folder / name for name in robot_files(spec))
    check_no_input(out_path, (path, draft_path, *reference.files, *robot_paths))
    check_file(out_path)
    built = build_contract(draft, reference, spec, str(draft_path))
    runs, golden = (
        record_reference(reference, built.columns, built.joints),
        _golden(reference, built, str(path)),
    )
    model = to_standard_graph(reference, built.columns.tolist(), built.joints.tolist())
    compare = partial(check_parity, runs=runs, source=str(path))
    digest, deviation = write_policy(out_path, model, built.contract, golden, spec, compare)
    return ImportResult(facts=reference.facts, digest=digest, deviation=deviation)


def _golden(reference: ReferencePolicy, built: BuiltContract, source: str) -> Golden:
    """Return golden pairs: one sequence of the reference from its initial state."""
    inputs = reference.sample_observations(np.random.default_rng(1), (GOLDEN_STEPS,))
    observation = reference.reorder_observations(inputs, built.columns)
    action = reference.run(inputs, np.arange(GOLDEN_STEPS) == 0)[:, built.joints]
    pairs = {"observation": observation.tolist(), "action": action.tolist()}
    return parse(pairs, Golden, source=f"{source}: golden pairs", error=ContractError)


def write_template(
    path: Path, draft_path: Path, descriptor: Path | None = None, robot: str | Path | None = None
) -> tuple[PolicyFacts, int]:
    """Write the contract's TOML, filled in from the policy's file; return the facts and the number of open values.

    Args:
        robot: name or folder, if known.
        descriptor: YAML of Isaac Lab's I/O descriptors, for values that the policy's file does not have.
    """
    if os.path.exists(draft_path):
        raise ContractError(f"{draft_path}: exists already, expected another path, or remove it first")
    try:
        facts = read_policy(path, NetworkSettings()).facts
    except MissingSettingError as e:
        facts = e.facts
    if descriptor is not None:
        facts = _merge_descriptor(facts, read_descriptor(descriptor, facts.observations))
    if robot is not None:
        facts = _merge_robot(facts, load_robot(robot))
    text, open_count = render_template(facts, printable(path.name))
    with replacing(draft_path, "--contract") as written:
        written.write_text(text, encoding="utf-8")
    return facts, open_count


def _merge_robot(facts: PolicyFacts, spec: RobotSpec) -> PolicyFacts:
    fitting = tasks_of(spec)
    task = {"task": fitting[0]} if len(fitting) == 1 else {}
    return replace(facts, known={**facts.known, "robot": spec.name, **task})


def _merge_descriptor(facts: PolicyFacts, descriptor: dict[str, Any]) -> PolicyFacts:
    """Add the descriptor's values; the policy's own file takes precedence."""
    action = {**descriptor.get("action", {}), **facts.known.get("action", {})}
    return replace(facts, known={**descriptor, **facts.known, "action": action})


def policy_import(
    file: Annotated[Path, typer.Argument(help="policy file as written by its library")],
    as_: Annotated[Literal["firstshift"], FORMAT] = "firstshift",
    contract: Annotated[Path | None, CONTRACT] = None,
    out: Annotated[Path | None, OUT] = None,
    robot: Annotated[str | None, ROBOT] = None,
    template: Annotated[bool, TEMPLATE] = False,
    descriptor: Annotated[Path | None, DESCRIPTOR] = None,
) -> int:
    """Import a policy: ONNX, rsl_rl, Stable-Baselines3, TorchScript, torch.export, or weights with their contract."""
    if not file.name:
        raise ConfigError(f"{file}: found the name of a folder, expected that of a policy file")
    draft_path = contract or file.with_suffix(".toml")
    if descriptor is not None and not template:
        raise ConfigError(f"--descriptor {descriptor}: found without --template, expected both")
    if is_missing(file):
        raise ContractError(f"{file}: cannot be read: no such file")
    with limit_memory(file):
        if template:
            facts, count = write_template(file, draft_path, descriptor, robot)
            todo = f"fill in {count} values marked ?" if count else "all values are filled in"
            print(printable(f"{draft_path}: {_describe(facts)}; {todo}"))
        else:
            _run_import(file, draft_path, out or Path("out", f"{file.stem}.onnx"), robot)
    return PASSED


def _run_import(file: Path, draft_path: Path, out_path: Path, robot: str | None) -> None:
    started = time.monotonic()
    with plain_console(stderr=True).status(Text(printable(f"importing {file.name}"))):
        imported = import_policy(file, draft_path, out_path, robot)
    print(printable(f"{out_path}: {_describe(imported.facts)}, sha256 {imported.digest}"))
    print(
        f"agrees with the original on 1,024 observations and 16 sequences of 200 steps, for 1 and 64 robots:"
        f" largest deviation {imported.deviation:.1e}, in {time.monotonic() - started:.0f} s"
    )


def _describe(facts: PolicyFacts) -> str:
    return f"{facts.kind}, {facts.observations} observations, {facts.actions} actions"


def cli() -> None:
    """Entry point of `policy-import`."""
    main(policy_import)
