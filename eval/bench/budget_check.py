"""Shipped budget: half an hour of 32 robots must pass it, an idle policy must fail it."""

import json
import tempfile
from functools import reduce
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper
from rich.console import Console

from deploy.policy.onnx_graph import read_model
from deploy.policy.policy_file import FILE_BYTES_MAX
from deploy.policy.policy_names import GOLDEN_KEY, OUTPUT
from eval.bench.soak_setup import soak_config
from eval.judge.counts import merge
from eval.judge.monitors import MONITORS
from eval.soak.workers import run_soak
from eval.statistics.budget import check, load_budget
from robots.files import read_file
from robots.spec import RobotSpec

ROBOTS, HOURS, IDLE_HOURS = 32, 0.5, 0.05


def budget_check(spec: RobotSpec, policy: Path, console: Console) -> None:
    """Print goals, availability and hard events of the policy and of an idle one."""
    with tempfile.TemporaryDirectory() as folder:
        idle = make_idle(policy, Path(folder, "idle.onnx"))
        for path, hours in ((policy, HOURS), (idle, IDLE_HOURS)):
            soak = soak_config(spec, path, hours=hours, robots=ROBOTS, workers=2)
            shards = run_soak(soak, Path(folder, path.stem), console)
            counts = reduce(merge, (shard.counts for shard in shards))
            exceeded = ", ".join(line.name for line in check(load_budget(), counts) if not line.passed)
            hard = sum(counts.total(monitor.name) for monitor in MONITORS if monitor.hard)
            console.print(
                f"{path.name}, {ROBOTS} robots x {hours:g} h: goals {100 * counts.goal_success:.2f} % (at least 97),"
                f" availability {100 * counts.availability:.2f} % (at least 99), hard events {hard} (at most 0):"
                f" budget {f'exceeded by {exceeded}' if exceeded else 'kept'}"
            )


def make_idle(policy: Path, out: Path) -> Path:
    """Copy a policy with its last layer and its golden actions set to zero; return `out`."""
    model = read_model(read_file(policy, FILE_BYTES_MAX), str(policy))
    last = next(node for node in model.graph.node if OUTPUT in node.output)
    for tensor in model.graph.initializer:
        if tensor.name in last.input:
            zeros = np.zeros_like(numpy_helper.to_array(tensor))
            tensor.CopyFrom(numpy_helper.from_array(zeros, tensor.name))
    for prop in model.metadata_props:
        if prop.key == GOLDEN_KEY:
            pairs = json.loads(prop.value)
            pairs["action"] = np.zeros_like(pairs["action"]).tolist()
            prop.value = json.dumps(pairs)
    onnx.save(model, out)
    return out
