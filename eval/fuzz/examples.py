"""Valid files of every kind that the robot's computer reads, small and made in seconds."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from onnx import NodeProto, TensorProto, helper, numpy_helper

from deploy.operation.temperature_file import Temperatures
from deploy.policy.contract import Contract
from deploy.policy.contract_action import ActionSpec
from deploy.policy.contract_term import Term
from deploy.policy.policy import Policy
from deploy.policy.policy_names import CONTRACT_KEY, GOLDEN_KEY, INPUT, OUTPUT
from eval.history.history import add_record
from eval.history.soak_record import Run, Settings, SoakRecord
from eval.judge.monitors import MONITORS
from eval.replay.event_capture import EventCapture
from eval.shard.job import ShardJob
from eval.shard.shard import Shard
from eval.soak.configuration import SoakConfig
from eval.statistics.budget import BUDGET
from eval.statistics.per_draw_counts import PerDrawCounts
from robots.distributions import load_distributions
from robots.draws import draw
from robots.randomness import robot_seed
from robots.spec import ROBOTS, RobotSpec, load_robot

ARM = ROBOTS / "arm6"
SEED, DRAWS = 7, 2
PUSHES = {"force_n": (2000.0, 3000.0), "lasts_s": (0.1, 0.2), "every_s": (1.0, 1.1)}
"""Pushes that no robot withstands: they make events in the first seconds."""
PUSHED_TICKS, CHECKPOINT_TICKS = 400, 100


def make_policy(folder: Path, spec: RobotSpec | None = None) -> Path:
    """Write a policy of the arm that asks for nothing."""
    spec = spec or load_robot(ARM)
    n = spec.n
    angles = Term(name="q", source="joint_position", frame="joint", unit="rad", size=n, scale=(1.0,) * n)
    action = ActionSpec(mode="position_increment", size=n, scale=(0.05,) * n, clip=(-1.0, 1.0), leash_rad=0.3)
    contract = Contract(
        robot=spec.name,
        robot_digest=spec.digest,
        joint_names=spec.joint_names,
        policy_hz=50,
        control_hz=spec.rates.control_hz,
        task="reach",
        observation=(angles,),
        action=action,
        trained={"recipe": "none"},
    )
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", n]) for name in (INPUT, OUTPUT)]
    nodes = [helper.make_node("MatMul", [INPUT, "w"], ["h"]), _scan(n)]
    weights = [
        numpy_helper.from_array(np.zeros(shape, np.float32), name)
        for name, shape in (("w", (n, n)), ("begin", (n,)))
    ]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    golden = json.dumps({"observation": [[0.5] * n], "action": [[0.0] * n]})
    helper.set_model_props(model, {CONTRACT_KEY: contract.to_json(), GOLDEN_KEY: golden})
    (path := folder / "policy.onnx").write_bytes(model.SerializeToString())
    return path


def _scan(n: int) -> NodeProto:
    """Return a node that computes the action of each robot in a trip of its own: its graph is within the graph."""
    inputs, outputs = (
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, [n]) for name in names]
        for names in (("state", "row"), ("next", "squashed"))
    )
    inner = [
        helper.make_node("Identity", ["state"], ["next"]),
        helper.make_node("Tanh", ["row"], ["squashed"]),
    ]
    body = helper.make_graph(inner, "body", inputs, outputs)
    axes: dict[str, Any] = {"scan_input_axes": [0], "scan_output_axes": [0]}
    return helper.make_node("Scan", ["begin", "h"], ["end", OUTPUT], body=body, num_scan_inputs=1, **axes)


def make_robot(folder: Path) -> None:
    """Copy the arm's folder."""
    shutil.copytree(ARM, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.md"))


def make_draws(folder: Path) -> None:
    """Write the draws of two arms."""
    spec = load_robot(ARM)
    distributions, seeds = load_distributions(spec), [robot_seed(SEED, robot) for robot in range(DRAWS)]
    text = draw(distributions, spec, seeds).to_json(SEED, distributions, spec)
    (folder / "draws.json").write_text(text, encoding="utf-8")


def soak_config(folder: Path) -> SoakConfig:
    """Return the soak whose checkpoint `make_checkpoint` writes; the policy's file must be in `folder`."""
    spec, path = load_robot(ARM), folder / "policy.onnx"
    extent: dict[str, Any] = {"hours": 0.001, "robots": DRAWS, "seed": SEED, "workers": 1}
    return SoakConfig(spec=spec, policy=Policy.load(path, spec), policy_path=path, budget=BUDGET, **extent)


def make_checkpoint(folder: Path) -> None:
    """Soak arms for some seconds, and write the checkpoint of their shard."""
    make_policy(folder)
    config = soak_config(folder)
    (job,) = config.jobs()
    shard = Shard(job)
    shard.run(lambda _: None, lambda: shard.runtime.ticks >= CHECKPOINT_TICKS)
    config.checkpoint(0, folder).store(shard.save())


def make_heat(folder: Path) -> None:
    """Write the motor temperatures of an arm."""
    spec = load_robot(ARM)
    heat = Temperatures(robot=spec.name, joints=spec.joint_names, unix_s=1e9, rise_k=(1.0,) * spec.n)
    (folder / "heat.json").write_text(heat.model_dump_json(), encoding="utf-8")


def make_history(folder: Path) -> None:
    """Write the record of a soak of two arms."""
    digests = {f"{part}_digest": "0" * 64 for part in ("robot", "draws", "limits", "policy", "code")}
    extent = {"seed": SEED, "hours": 8.0, "robots": DRAWS, "shard_width": 16, "workers": 2}
    names = {"command": "soak-test", "robot": "arm6", "policy": "arm.onnx", "budget": "budget.toml"}
    settings = Settings.model_validate({**digests, **extent, **names, "faults": None, "versions": {}})
    whole, none = (5_760_000,) * DRAWS, (0,) * DRAWS
    hard = {monitor.name: none for monitor in MONITORS if monitor.hard}
    columns = {
        "ticks": whole,
        "running": whole,
        "invalid": none,
        "stops": none,
        "due": whole,
        "reached": whole,
    }
    counts = PerDrawCounts(dt=0.005, hard=hard, hottest_c=(70.0,) * DRAWS, **columns)
    run = Run(
        started="2026-01-02T22:00:00+01:00", wall_s=60.0, hours=8.0, resumed_hours=0.0, interrupted=False
    )
    record = SoakRecord(
        format=2, verdict="passed", statement="None.", settings=settings, run=run, per_draw_counts=counts
    )
    add_record(record.model_copy(update={"results_digest": record.sealed()}), folder)


def make_bundle(folder: Path) -> None:
    """Soak arms that are pushed for some seconds, and keep the bundle of one event."""
    events, robot = folder / "events", folder / "pushed"
    make_robot(robot)
    text = (robot / "draws.toml").read_text(encoding="utf-8")
    for name, (low, high) in PUSHES.items():
        text = re.sub(rf"(?m)^{name} = .*$", f"{name} = {{ low = {low}, high = {high} }}", text)
    (robot / "draws.toml").write_text(text, encoding="utf-8")
    spec = load_robot(robot)
    policy = make_policy(folder, spec)
    digests: dict[str, Any] = {"robot_digest": spec.digest, "policy_digest": Policy.load(policy, spec).digest}
    extent: dict[str, Any] = {
        "seed": SEED,
        "first": 0,
        "robots": DRAWS,
        "ticks": PUSHED_TICKS,
        "sample_ticks": PUSHED_TICKS,
    }
    job = ShardJob(robot=robot, policy=policy, **digests, **extent)
    shard = Shard(job)
    capture = EventCapture(job, shard, events)
    shard.run(lambda _: None, lambda: False, lambda: capture.flush(shard), capture.observe)
    min(events.iterdir()).rename(folder / "bundle")
    for place in (events, robot):
        shutil.rmtree(place)
    policy.unlink()
