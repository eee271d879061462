"""Readers of files of unknown origin on a computer with torch, besides those of `eval.fuzz.targets`."""

import shutil
from collections.abc import Callable
from pathlib import Path

from eval.fuzz.examples import ARM
from eval.fuzz.target import Target
from eval.fuzz.targets import TARGETS as WITHOUT_TORCH
from policies.fuzz import examples
from policies.importers.contract_draft import read_draft
from policies.importers.onnx_files.isaac_lab import read_descriptor
from policies.importers.readers import read_policy
from policies.importers.stable_baselines.vec_normalize import read_vec_normalize
from policies.importers.torch_files.network_settings import NetworkSettings
from policies.robot_init.cli import init_robot
from policies.training.checkpoint import load_checkpoint
from policies.training.recipe import load_recipe

_ANSWERS = {"activation": "elu"}


def _reader(suffix: str, **network: str) -> Callable[[Path], object]:
    """Return a function that reads the policy file of a folder, with these settings of its network."""
    settings = NetworkSettings.model_validate(network)
    return lambda folder: read_policy(folder / f"policy{suffix}", settings)


def _read_texts(folder: Path) -> None:
    """Read a contract's TOML, a recipe and a descriptor, of which one was mutated."""
    read_draft(folder / "draft.toml")
    load_recipe(folder / "recipe.toml")
    read_descriptor(folder / "descriptor.yaml", examples.DESCRIBED)


def _init(model: str) -> Callable[[Path], object]:
    """Return a function that makes a robot's folder from a vendor's model."""

    def init(folder: Path) -> None:
        out = folder / "robot"
        shutil.rmtree(out, ignore_errors=True)
        init_robot(folder / model, out)
        shutil.rmtree(out)

    return init


TARGETS = {
    **WITHOUT_TORCH,
    "ONNX": Target(make=examples.make_import("ONNX"), read=_reader(".onnx")),
    "rsl_rl": Target(make=examples.make_import("rsl_rl, MLP"), read=_reader(".pt", **_ANSWERS)),
    "TorchScript": Target(make=examples.make_import("TorchScript, LSTM"), read=_reader(".pt")),
    "torch.export": Target(make=examples.make_import("torch.export"), read=_reader(".pt2")),
    "state_dict": Target(
        make=examples.make_import("state_dict"), read=_reader(".pt", normalizer="none", **_ANSWERS)
    ),
    "Stable-Baselines3": Target(
        make=examples.make_stable_baselines, read=_reader(".zip", normalizer="none"), files="*.zip"
    ),
    "VecNormalize": Target(
        make=examples.make_stable_baselines,
        read=lambda folder: read_vec_normalize(folder / "vecnormalize.pkl"),
        files="*.pkl",
    ),
    "checkpoint": Target(
        make=examples.make_checkpoint, read=lambda folder: load_checkpoint(folder / "arm.pt")
    ),
    "texts": Target(make=examples.make_draft, read=_read_texts),
    "vendor MJCF": Target(
        make=lambda folder: shutil.copyfile(ARM / "model.xml", folder / "model.xml"), read=_init("model.xml")
    ),
    "vendor URDF": Target(make=examples.make_urdf, read=_init("two.urdf")),
}
