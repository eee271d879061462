"""Readers of files of unknown origin on a computer without torch."""

import hashlib
import io
import json
import shutil
from pathlib import Path

import numpy as np
from rich.console import Console

from deploy.operation.temperature_file import CHARACTERS_MAX, Temperatures
from deploy.policy.policy import Policy
from eval.fuzz import examples
from eval.fuzz.target import Target
from eval.history.history import pool, read_history
from eval.judge.limits import load_limits
from eval.replay import bundle
from eval.replay.bundle_files import state_digest
from eval.replay.replayer import Replay
from eval.soak.checkpoint import DIGEST, IDENTITY, NAME
from eval.soak.options import PROFILES, load_profile
from eval.soak.workers import resumed_ticks
from eval.statistics.budget import load_budget
from robots.distributions import load_distributions
from robots.draws import load_draw
from robots.models.fleet import Fleet
from robots.models.mujoco_model import load_mujoco
from robots.models.sandbox import check_compiles
from robots.spec import load_robot
from robots.strict import parse, read_json_file

_SPEC = load_robot(examples.ARM)
_DISTRIBUTIONS = load_distributions(_SPEC)


def _read_tables(folder: Path) -> None:
    """Read a robot's tables, in the order in which a soak does."""
    spec = load_robot(folder)
    load_distributions(spec)
    load_limits(spec)


def _read_model(folder: Path) -> None:
    """Compile a robot's model in the sandbox, then build all that is made of it."""
    spec = load_robot(folder)
    check_compiles(spec.model_path, spec.folder)
    load_mujoco(spec)
    Fleet(spec, 1, collisions=True)


def _read_heat(folder: Path) -> None:
    parse(read_json_file(folder / "heat.json", CHARACTERS_MAX), Temperatures, source="heat.json")


def _read_history(folder: Path) -> None:
    if records := read_history(folder):
        pool(records)


def _make_profile(folder: Path) -> None:
    shutil.copyfile(PROFILES / "faults.toml", folder / "profile.toml")
    shutil.copyfile(PROFILES.parent / "budget.toml", folder / "budget.toml")


def _read_profile(folder: Path) -> None:
    load_profile(str(folder / "profile.toml"))
    load_budget(folder / "budget.toml")


def _read_checkpoint(folder: Path) -> None:
    resumed_ticks(examples.soak_config(folder), folder, Console(quiet=True))


def _seal_checkpoint(folder: Path) -> None:
    """Renew the digest of a checkpoint whose arrays can still be read."""
    (path,) = folder.glob(NAME.format("*"))
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        stored = {name: array for name, array in arrays.items() if name not in (IDENTITY, DIGEST)}
        arrays[DIGEST] = np.array(state_digest(stored))
    except Exception:  # noqa: BLE001 - mutated bytes can fail in any way
        return
    np.savez(path, **arrays)


def _seal_bundle(folder: Path) -> None:
    """Renew the digests of a bundle whose list of files can still be read."""
    path = folder / "bundle" / bundle.INFO
    try:
        listed = json.loads(path.read_text(encoding="utf-8"))
        for name in listed["files"]:
            listed["files"][name] = hashlib.sha256((path.parent / name).read_bytes()).hexdigest()
        sealed = bundle.BundleInfo.model_validate_json(json.dumps(listed)).sealed()
    except (ValueError, TypeError, KeyError, AttributeError, OSError, RecursionError):
        return
    path.write_text(json.dumps({**listed, "digest": sealed}), encoding="utf-8")


TARGETS = {
    "policy": Target(
        make=examples.make_policy, read=lambda folder: Policy.load(folder / "policy.onnx", _SPEC)
    ),
    "tables": Target(make=examples.make_robot, read=_read_tables, files="*.toml"),
    "MJCF": Target(make=examples.make_robot, read=_read_model, files="*.xml"),
    "draws": Target(
        make=examples.make_draws,
        read=lambda folder: load_draw(folder / "draws.json", _DISTRIBUTIONS, _SPEC),
    ),
    "heat": Target(make=examples.make_heat, read=_read_heat),
    "history": Target(make=examples.make_history, read=_read_history),
    "profile": Target(make=_make_profile, read=_read_profile),
    "soak checkpoint": Target(
        make=examples.make_checkpoint, read=_read_checkpoint, files=NAME.format("*"), seal=_seal_checkpoint
    ),
    "bundle": Target(
        make=examples.make_bundle, read=lambda folder: Replay(folder / "bundle"), seal=_seal_bundle
    ),
}
