"""make bench: times of importing each kind of policy file, and of loading and verifying a policy.

python -m policies.bench import     each kind of file, from the start of the command to its end
python -m policies.bench load       a policy, from its file to the end of its golden pairs
python -m policies.bench episodes   the first hundred episodes of a training on four robots
python -m policies.bench            the first two
"""

import contextlib
import logging
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomlkit
import torch
import typer
from rsl_rl.models import MLPModel, RNNModel
from tensordict import TensorDict
from torch import nn

from deploy.command_line import PASSED, main
from deploy.policy.policy import Policy
from deploy.telemetry.plain_console import plain_console
from policies.first_episodes import first_episodes
from robots.child_process import Lifeline
from robots.errors import ConfigError
from robots.spec import RobotSpec, load_robot

SOURCES = ("joint_position", "joint_velocity", "goal_position", "last_action")
LAYERS = (512, 256, 128)
LOADS = 9
SCRIPT = """
import sys
from robots.child_process import end_with
end_with(sys.stdin.fileno())
from policies.importers.cli import cli
cli()
"""
"""policy-import that ends with the bench."""
RNN = {"rnn_type": "lstm", "rnn_hidden_dim": 256, "rnn_num_layers": 1}

console = plain_console(width=120)
Files = dict[str, tuple[Path, dict[str, str]]]


def write_files(folder: Path, spec: RobotSpec, layers: tuple[int, ...] = LAYERS) -> Files:
    """Write a file of each kind for a robot; return paths, and the contract's [network] table of each."""
    n, a = 3 * spec.n + 3, spec.n
    elu = {"activation": "elu"}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # warnings about optional libraries
    with warnings.catch_warnings(), contextlib.redirect_stdout(None):
        warnings.filterwarnings("ignore", "`torch.jit")  # deprecated; the files of others stay
        mlp, lstm = _actor(MLPModel, n, a, layers), _actor(RNNModel, n, a, layers, **RNN)
        for name, model in (("mlp", mlp), ("lstm", lstm)):
            torch.save({"actor_state_dict": model.state_dict(), "iter": 0}, folder / f"{name}.pt")
        torch.jit.save(torch.jit.script(lstm.eval().as_jit()), folder / "motion.pt")
        view = mlp.eval().as_onnx(verbose=False).eval()
        names: dict[str, Any] = {"input_names": view.input_names, "output_names": view.output_names}
        inputs = view.get_dummy_inputs()
        torch.onnx.export(view, inputs, folder / "policy.onnx", opset_version=18, verbose=False, **names)
        plain = _plain(n, a, layers)
        torch.save(plain.state_dict(), folder / "weights.pt")
        torch.export.save(torch.export.export(plain, (torch.zeros(1, n),)), folder / "policy.pt2")
    return {
        "ONNX": (folder / "policy.onnx", {}),
        "rsl_rl, MLP": (folder / "mlp.pt", elu),
        "rsl_rl, LSTM": (folder / "lstm.pt", elu),
        "TorchScript, LSTM": (folder / "motion.pt", {}),
        "torch.export": (folder / "policy.pt2", {}),
        "state_dict": (folder / "weights.pt", {**elu, "normalizer": "none"}),
    }


def _actor(kind: Callable[..., Any], n: int, a: int, layers: tuple[int, ...], **settings: Any) -> Any:
    example = TensorDict({"policy": torch.zeros(1, n)}, batch_size=[1])
    settings |= {"hidden_dims": layers, "obs_normalization": True}
    settings["distribution_cfg"] = {"class_name": "GaussianDistribution"}
    return kind(example, {"actor": ["policy"]}, "actor", a, **settings)


def _plain(n: int, a: int, layers: tuple[int, ...]) -> nn.Sequential:
    parts: list[nn.Module] = []
    for size in layers:
        parts += [nn.Linear(n, size), nn.ELU()]
        n = size
    return nn.Sequential(*parts, nn.Linear(n, a))


def contract(spec: RobotSpec, network: dict[str, str]) -> str:
    """Return the contract's TOML, the same for all files except [network]."""
    plain = {"offset": "none", "multiply": 1.0, "clip": "none"}
    return tomlkit.dumps(
        {
            "robot": spec.name,
            "task": "reach",
            "policy_hz": 50,
            "joint_names": list(spec.joint_names),
            "observation": [{"name": source, "source": source, **plain, "history": 1} for source in SOURCES],
            "action": {"mode": "position", **plain, "offset": 0.0, "kp": "none", "kd": "none"},
            "network": network,
        }
    )


def imports(spec: RobotSpec, policy: Path) -> None:
    """Print the wall time of the import command for each kind; `policy` is not used."""
    command = [sys.executable, "-c", SCRIPT]
    with tempfile.TemporaryDirectory() as place, Lifeline() as lifeline:
        for kind, (path, network) in write_files(Path(place), spec).items():
            draft, out = path.with_suffix(".toml"), path.with_suffix(".ours.onnx")
            draft.write_text(contract(spec, network), encoding="utf-8")
            start = time.perf_counter()
            options = ["--contract", str(draft), "--robot", str(spec.folder), "--out", str(out)]
            arguments = [*command, str(path), *options]
            subprocess.run(arguments, check=True, stdin=lifeline.end.fileno(), stdout=subprocess.DEVNULL)
            spent = time.perf_counter() - start
            console.print(
                f"policy-import, {kind}: {spent:.1f} s (at most 60), {os.stat(out).st_size >> 10} KiB"
            )


def loads(spec: RobotSpec, policy: Path) -> None:
    """Print the median time of loading and verifying a policy."""
    times = []
    for _ in range(LOADS):
        start = time.perf_counter()
        Policy.load(policy, spec)
        times.append(time.perf_counter() - start)
    console.print(
        f"{policy.name}: loaded and verified in {np.median(times):.3f} s (median of {LOADS}, at most 0.5)"
    )


def episodes(spec: RobotSpec, policy: Path) -> None:
    """Print what short trainings of the planar arm come to; robot and policy are not used."""
    first_episodes(console)


BENCHES = {"import": imports, "load": loads, "episodes": episodes}
NOT_IN_ALL = ("episodes",)
"""It takes a quarter of an hour."""


def bench(
    which: Annotated[str, typer.Argument(help=f"One of {', '.join(BENCHES)}, or all.")] = "all",
    policy: Annotated[Path, typer.Option(help="ONNX file that policy-export wrote.")] = Path("out/arm.onnx"),
    robot: Annotated[str, typer.Option(help="Robot: a name or a folder.")] = "arm6",
) -> int:
    """Measure the times of importing and loading policies."""
    if which not in (*BENCHES, "all"):
        raise ConfigError(f"bench: found {which!r}, expected one of {', '.join(BENCHES)} or all")
    spec = load_robot(robot)
    for name, measure in BENCHES.items():
        if which == name or (which == "all" and name not in NOT_IN_ALL):
            measure(spec, policy)
    return PASSED


if __name__ == "__main__":
    main(bench)
